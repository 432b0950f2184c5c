"""The pixels of a picture that show a material: errors of objects are not to be hidden by a floor. Not a program."""

import numpy as np


def pixels_of(material: str, relighter, view) -> np.ndarray:
    """The pixels of a view of transport that show a material."""
    shown = np.zeros(view.surfaces.covered.size + 1, bool)
    for part in view.surfaces.parts:
        if relighter.materials[part.material].name == material:
            shown[np.asarray(part.pixels.pixel)] = True
    return shown[:-1].reshape(view.surfaces.shape)


def only(picture: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """The picture with nothing covered but some pixels."""
    return np.concatenate([picture[..., :3], np.where(chosen, picture[..., 3], 0)[..., None]], axis=-1)
