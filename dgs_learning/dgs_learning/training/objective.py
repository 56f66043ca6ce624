"""Equation (6) of the paper for one batch as a module, so that DistributedDataParallel can wrap it."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from dgs_grasp_planner.network import DGSNet
from dgs_grasp_planner.network.dgs_net import likeliest_rotation, teacher_logits
from dgs_grasp_planner.network.module_one import ModuleOneOutput
from dgs_grasp_planner.network.module_two import ModuleTwoOutput
from dgs_grasp_planner.network.rotation import sixd_from_matrix
from dgs_learning.training.batches import TrainingBatch
from dgs_learning.training.losses import (
    LossWeights,
    graspable,
    joint_loss,
    offset_loss,
    rotation_loss,
    score_loss,
)


class Objective(nn.Module):
    """The weighted sum of the losses, its terms, and a few readable errors."""

    def __init__(self, net: DGSNet, weights: LossWeights, teacher: bool = True):
        """Hold the network.

        Args:
            net: to be trained.
            weights: lambda of equation (6).
            teacher: module II gets the labels' scores and rotations (paper); else module I's own.
        """
        super().__init__()
        self.net, self.weights, self.teacher = net, weights, teacher

    def forward(self, batch: TrainingBatch) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss, and its terms as tensors without gradient: reading them would make the host wait for a GPU.

        Module II sees the ground truth at the labelled voxels, one grasp drawn per voxel, and module I's rotation
        elsewhere.
        """
        weights = self.weights
        one = self.net.module_one(batch.voxels)
        rotation, hypothesis, angle = rotation_loss(
            one.rotation6d[batch.voxel],
            one.hypothesis_logits[batch.voxel],
            batch.rotation,
            batch.weight,
            weights,
        )
        two = self._module_two(one, batch)
        rows, weight = batch.voxel[batch.chosen], batch.weight[batch.chosen]
        terms = {
            "score": score_loss(one.score_logits, batch.kind),
            "rotation": rotation,
            "hypothesis": hypothesis,
            "offset": offset_loss(
                two.offset[rows], batch.offset[batch.chosen], weight, weights.offset_epsilon
            ),
            "j_init": joint_loss(two.j_init[rows], batch.j_init[batch.chosen], weight),
            "j_end": joint_loss(two.j_end[rows], batch.j_end[batch.chosen], weight),
        }
        used = [name for name in terms if name != "hypothesis" or one.hypothesis_logits.shape[1] > 1]
        total = sum(
            (getattr(weights, name) * terms[name] for name in used), torch.zeros((), device=angle.device)
        )
        with torch.no_grad():
            values = {"loss": total, **terms, **readable_errors(one, two, batch, angle)}
            return total, {name: value.detach().float() for name, value in values.items()}

    def _module_two(self, one: ModuleOneOutput, batch: TrainingBatch) -> ModuleTwoOutput:
        fed = likeliest_rotation(one.rotation6d, one.hypothesis_logits).detach().float()
        score = one.score_logits.detach()
        if self.teacher:
            rows = batch.voxel[batch.chosen]
            fed = fed.index_copy(0, rows, sixd_from_matrix(batch.rotation[batch.chosen]))
            score = teacher_logits(graspable(batch.kind))
        dtype = one.features.dtype
        return self.net.module_two(one.features, score.to(dtype), fed.to(dtype), batch.voxels)


def readable_errors(
    one: ModuleOneOutput, two: ModuleTwoOutput, batch: TrainingBatch, angle: Tensor
) -> dict[str, Tensor]:
    """Precision and recall of the points, median errors of angle [deg] and offset [mm], mean error of joints [rad].

    Args:
        one, two: the network's answers.
        batch: with the labels.
        angle: (P,) errors of the nearest hypothesis [rad].

    Returns:
        0-dimensional tensors; NaN where the batch has no label.
    """
    predicted, positive = one.score_logits.argmax(1) > 0, graspable(batch.kind)
    hits = (predicted & positive).sum()
    rows = batch.voxel[batch.chosen]
    return {
        "precision": hits / predicted.sum().clamp(min=1),
        "recall": hits / positive.sum().clamp(min=1),
        "angle_deg": torch.rad2deg(angle).median(),
        "offset_mm": (two.offset[rows] - batch.offset[batch.chosen]).norm(dim=1).median() * 1e3,
        "j_end_rad": (two.j_end[rows] - batch.j_end[batch.chosen]).abs().mean(),
    }
