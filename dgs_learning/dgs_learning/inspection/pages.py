"""All contact sheets of a dataset as files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from dgs_learning.dataset import GraspDataset
from dgs_learning.inspection.grasp_sheet import grasp_sheet
from dgs_learning.inspection.scene_sheet import scene_sheet
from dgs_learning.inspection.sheet import save
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES


def draw_pages(data: GraspDataset, folder: Path, per_class: int, scenes: int, seed: int) -> Iterator[Path]:
    """Draw `grasps_CLASS.png` and `scenes.png`; yields each file when it is written.

    Args:
        data: what to draw from.
        folder: pictures go here.
        per_class: grasps per page.
        scenes: scenes on the last page; 0 = none.
        seed: decides which are drawn.
    """
    for shape_class in SHAPE_CLASSES:
        page = grasp_sheet(data, shape_class, per_class, seed)
        if page is not None:
            save(folder / f"grasps_{shape_class}.png", page)
            yield folder / f"grasps_{shape_class}.png"
    if scenes and data.scenes:
        numbers = np.random.default_rng(seed).permutation(len(data.scenes))[:scenes]
        save(folder / "scenes.png", scene_sheet(data, sorted(numbers.tolist()), seed))
        yield folder / "scenes.png"
