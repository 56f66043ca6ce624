"""What a file of weights was trained on, by the notes beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dgs_description.errors import DgsError, ErrorCode
from dgs_grasp_planner.network.weights import ModelInfo, file_sha256, read_info


@dataclass(frozen=True, order=True)
class History:
    """What one file of weights has seen.

    Attributes:
        another_dataset: not the one that is at hand.
        grasps: stage-1 grasps of each object at most; 0 = all.
        scenes: 0 = not noted.
        views: with those of the weights that it began from.
        form: of the network, where it is not that of the weights that ship.
    """

    another_dataset: bool
    grasps: int
    scenes: int
    views: int
    form: str = ""

    def __str__(self) -> str:
        scenes = f" of {self.scenes} scenes" if self.scenes else ""
        dataset = " of an earlier dataset" if self.another_dataset else ""
        grasps = f", {self.grasps} grasps an object" if self.grasps else ""
        return f"{self.views} views{scenes}{dataset}{grasps}{self.form and f', {self.form}'}"


def history(weights: Path, dataset: Path, others: Sequence[Path] = ()) -> History:
    """What the notes beside a file of weights say.

    Args:
        weights: `folder/name` with or without `.pt`.
        others: files of weights that it may have begun from.

    Raises:
        DgsError: WEIGHTS_MISSING; REQUEST_INVALID: the notes tell of no training, or of weights that are not at hand.
    """
    info, *before = (read_info(file.parent, file.with_suffix("").name) for file in (weights, *others))
    trained_on = info.notes.get("dataset", {}).get("sha256")
    training = info.notes.get("training", {})
    scenes, grasps = (training.get(name, 0) for name in ("training_scenes", "grasps_per_object"))
    form = "as the paper prints it" if info.config.name == "paper" else ""
    if info.config.fixed_shapes:
        form = f"{info.config.fixed_shapes} fixed shapes of the hand"
    return History(trained_on != file_sha256(dataset), grasps, scenes, _views(info, before), form)


def _views(info: ModelInfo, others: Sequence[ModelInfo]) -> int:
    try:
        views = int(info.notes["step"]) * int(info.notes["training"]["batch"])
    except KeyError:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{info.model_id} has no notes of a training") from None
    init = info.notes.get("init")
    if not init:
        return views
    for other in others:
        if other.sha256 == init["sha256"]:
            return views + _views(other, others)
    began = f"{info.model_id} began from {init['model_id']}, which is not among the weights"
    raise DgsError(ErrorCode.REQUEST_INVALID, began)
