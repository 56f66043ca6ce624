"""Contact sheets: pictures with captions on a page with a title."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import zip_longest
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure
from numpy.typing import NDArray

DPI = 150
DEPTHS = matplotlib.colormaps["viridis"].with_extremes(bad="black")


def contact_sheet(
    path: Path, tiles: Sequence[NDArray], captions: Sequence[str], columns: int, width: float, title: str
) -> None:
    """Write one page as PNG.

    Args:
        tiles: (H, W, 3) uint8 pictures, or (H, W) numbers, which are drawn in colours and black where masked.
        captions: one per tile, of two lines.
        width: of a tile [inch].
        title: the first line is the larger.
    """
    rows = -(-len(tiles) // columns)
    height = width * max(tile.shape[0] / tile.shape[1] for tile in tiles) + 0.3
    page = Figure(figsize=(columns * width, rows * height + 0.6), dpi=DPI, layout="constrained")
    head, _, note = title.partition("\n")
    page.suptitle(head, fontsize=11, fontweight="bold")
    page.supxlabel(note, fontsize=7)
    places = page.subplots(rows, columns, squeeze=False).flat
    for place, tile, caption in zip_longest(places, tiles, captions):
        place.axis("off")
        if tile is not None:
            place.imshow(tile, cmap=DEPTHS)
            place.set_title(caption, fontsize=6, loc="left")
    path.parent.mkdir(parents=True, exist_ok=True)
    page.savefig(path)
