"""Contact sheets of pictures with a caption under each: what the studies show beside their numbers. Not a program."""

import pathlib
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float


def contact_sheet(
    path: pathlib.Path, pictures: Mapping[str, Float[np.ndarray, "h w c"]], columns: int, exposure: float
):
    """Writes linear pictures of one size as a PNG, tone-mapped alike, in rows of `columns`, each over its name."""
    from PIL import Image, ImageDraw, ImageFont

    from jaxrelight import tone_map

    font, margin, caption = ImageFont.load_default(14), 6, 22
    height, width = next(iter(pictures.values())).shape[:2]
    rows = -(-len(pictures) // columns)
    sheet = Image.new(
        "RGB", (columns * (width + margin) + margin, rows * (height + caption + margin) + margin), "white"
    )
    draw = ImageDraw.Draw(sheet)
    for i, (name, picture) in enumerate(pictures.items()):
        x, y = margin + i % columns * (width + margin), margin + i // columns * (height + caption + margin)
        sheet.paste(Image.fromarray(np.asarray(tone_map(picture[..., :3], exposure))), (x, y))
        draw.text((x + 2, y + height + 2), name, fill="black", font=font)
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
