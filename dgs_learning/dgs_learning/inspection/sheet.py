"""Contact sheets: tiles with captions on a page with a title."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageDraw, ImageFont

from dgs_sim_bridge.render.pictures import Picture

_INK, _MUTED, _PAGE = (33, 37, 43), (103, 110, 120), (255, 255, 255)
_GAP, _CAPTION, _TITLE = 12, 40, 64


@cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    weight = "bold" if bold else "normal"
    return ImageFont.truetype(font_manager.findfont(f"DejaVu Sans:weight={weight}"), size)


def contact_sheet(
    tiles: Sequence[Picture], captions: Sequence[tuple[str, str]], columns: int, title: str, note: str
) -> Picture:
    """One page.

    Args:
        tiles: (H, W, 3) uint8, all of one size.
        captions: per tile a line and a smaller second line.
        columns: tiles per row.
        title, note: at the top of the page.
    """
    height, width = tiles[0].shape[:2]
    rows = -(-len(tiles) // columns)
    page = Image.new(
        "RGB",
        (columns * (width + _GAP) + _GAP, _TITLE + rows * (height + _CAPTION + _GAP) + _GAP),
        _PAGE,
    )
    pen = ImageDraw.Draw(page)
    pen.text((_GAP + 2, 10), title, fill=_INK, font=_font(22, bold=True))
    pen.text((_GAP + 2, 39), note, fill=_MUTED, font=_font(13))
    for k, (tile, (line, small)) in enumerate(zip(tiles, captions, strict=True)):
        x = _GAP + (k % columns) * (width + _GAP)
        y = _TITLE + (k // columns) * (height + _CAPTION + _GAP)
        page.paste(Image.fromarray(tile), (x, y))
        pen.text((x + 2, y + height + 3), line, fill=_INK, font=_font(14))
        pen.text((x + 2, y + height + 21), small, fill=_MUTED, font=_font(12))
    return np.asarray(page)


def save(path: Path, picture: Picture) -> None:
    """Write a PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(picture).save(path, optimize=True)
