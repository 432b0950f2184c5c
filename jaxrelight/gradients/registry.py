"""All entries of the library, folder by folder."""

import importlib

from jaxrelight.gradients.entry import Entries

# Files of this folder that hold entries.
FOLDERS = (
    *("numerics", "basis", "brdf", "brdf_surfaces", "brdf_host", "lights", "operators", "transport", "lighting"),
    *("relighting", "geometry", "host_folders", "inverse_lamps", "inverse_light", "inverse_materials"),
)


def entries() -> Entries:
    """Those of all folders. Entries of `fitting`, which nothing here imports, are in `fitting.gradients`."""
    folders = [importlib.import_module(f"jaxrelight.gradients.{folder}") for folder in FOLDERS]
    return tuple(entry for folder in folders for entry in folder.ENTRIES)
