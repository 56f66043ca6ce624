"""How the success rate grows with training and data: what each file of weights has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from dgs_description.errors import DgsError, ErrorCode
from dgs_grasp_planner.network.weights import ModelInfo, file_sha256, read_info
from dgs_learning.evaluation.loss_chain import CHAIN, Step

MEASURED: tuple[Step, ...] = tuple(step for step in CHAIN if step.name in ("predicted", "proposed"))
"""Every file of weights alone, and within the planner."""
ALONE = "predicted"


@dataclass(frozen=True)
class Seen:
    """One file of weights.

    Attributes:
        folder: of the file, model: its name without `.pt`.
        views: that it was trained on, those of the weights it began from included.
        scenes: that they show; 0 = not noted.
        another_dataset: whether the dataset is not the present one.
    """

    folder: Path
    model: str
    views: int
    scenes: int
    another_dataset: bool

    @property
    def text(self) -> str:
        """Of its rows in the table."""
        scenes = f" of {self.scenes} scenes" if self.scenes else ""
        return f"{self.views} views{scenes}{' of an earlier dataset' if self.another_dataset else ''}"


def seen(weights: Path, dataset: Path, others: Sequence[Path] = ()) -> Seen:
    """What the notes beside a file of weights say.

    Args:
        weights: `folder/name` with or without `.pt`.
        dataset: the present dataset.
        others: files of weights that it may have begun from.

    Raises:
        DgsError: WEIGHTS_MISSING; REQUEST_INVALID: the notes tell of no training, or of weights that are not at hand.
    """
    weights = weights.with_suffix("")
    info = read_info(weights.parent, weights.name)
    training = info.notes.get("training", {})
    data = info.notes.get("dataset", {})
    return Seen(
        weights.parent,
        weights.name,
        _views(info, [read_info(o.parent, o.with_suffix("").name) for o in others]),
        training.get("training_scenes", 0),
        data.get("sha256") != file_sha256(dataset),
    )


def _views(info: ModelInfo, others: Sequence[ModelInfo]) -> int:
    try:
        views = int(info.notes["step"]) * int(info.notes["training"]["batch"])
    except KeyError:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{info.model_id} has no notes of a training") from None
    init = info.notes.get("init")
    if not init:
        return views
    before = next((other for other in others if other.sha256 == init["sha256"]), None)
    if before is None:
        raise DgsError(
            ErrorCode.REQUEST_INVALID,
            f"{info.model_id} began from {init['model_id']}, which is not among the weights",
        )
    return views + _views(before, others)
