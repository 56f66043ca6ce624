"""The losses of the paper, equations (1) to (6), extended to several rotation hypotheses and grasps per point."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from dgs_grasp_planner.network import DGSNet
from dgs_grasp_planner.network.dgs_net import rotation_of, teacher_logits
from dgs_grasp_planner.network.fixed_shapes import FixedShapes
from dgs_grasp_planner.network.module_one import ModuleOneOutput
from dgs_grasp_planner.network.module_two import ModuleTwoOutput
from dgs_grasp_planner.network.rotation import matrix_from_6d, sixd_from_matrix
from dgs_learning.training.batches import TrainingBatch

CLASS_WEIGHTS = (0.1, 1.0, 2.0)
"""omega of non-graspable, candidate and reference points (paper)."""


WEIGHTS = {"score": 10.0, "rotation": 1.0, "hypothesis": 1.0, "offset": 1.0, "j_init": 10.0, "j_end": 10.0}
"""lambda of equation (6). The paper gives no values. These bring every term to the order of one at the start."""
GEODESIC_SHARE = 0.5
"""lambda of equation (4)."""
OFFSET_EPSILON = 0.01
"""epsilon of equation (5) [m]."""
LOSERS_SHARE = 0.05
"""What the hypotheses that are not the nearest get of the rotation loss, so that none dies."""


def score_loss(logits: Tensor, kind: Tensor, worth: Tensor) -> Tensor:
    """Equation (1): weighted cross entropy over all N points, candidates and references positive, by their worth.

    Args:
        logits: (N, 2).
        kind: (N,) 0 = not graspable, 1 = candidate, 2 = reference.
        worth: (N,) which share of a candidate or reference is positive; with 1 it is the paper's loss.
    """
    none, candidate, reference = CLASS_WEIGHTS  # numbers: a GPU waits for a tensor that is copied to it
    of_one = torch.where(kind == 2, reference, torch.where(kind == 1, candidate, 0.0)) * worth
    of_none = none * torch.where(graspable(kind), 1 - worth, 1.0)
    log = F.log_softmax(logits.float(), dim=1)
    return -(of_none * log[:, 0] + of_one * log[:, 1]).mean()


def graspable(kind: Tensor) -> Tensor:
    """(N,) bool, candidate and reference points."""
    return (kind == 1) | (kind == 2)


def rotation_errors(predicted: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
    """Equations (2) and (3) per pair: squared Frobenius distance and angle [rad].

    Args:
        predicted: (..., 6) two column vectors, made orthonormal here.
        target: (..., 3, 3).
    """
    matrix = matrix_from_6d(predicted.float())
    frobenius = (matrix - target).square().sum((-1, -2))
    cosine = 0.5 * ((matrix * target).sum((-1, -2)) - 1.0)
    # acos has an infinite slope at +-1.
    return frobenius, torch.acos(cosine.clamp(-1 + 1e-5, 1 - 1e-5))


def rotation_loss(
    predicted: Tensor, logits: Tensor, target: Tensor, weight: Tensor, winner: Tensor | None = None
) -> tuple[Tensor, Tensor, Tensor]:
    """Equation (4) for P pairs and K hypotheses: the nearest hypothesis learns the grasp, its logit that it won.

    With K = 1 and unit weights this is the paper's loss.

    Args:
        predicted: (P, K, 6), logits: (P, K), target: (P, 3, 3), weight: (P,).
        winner: (P,) which hypothesis learns; None = the nearest.

    Returns:
        rotation loss, hypothesis loss, and the (P,) angle errors of the hypothesis that learns [rad].
    """
    frobenius, angle = rotation_errors(predicted, target[:, None])
    error = (1 - GEODESIC_SHARE) * frobenius + GEODESIC_SHARE * angle
    nearest = winner is None
    winner = error.detach().argmin(1) if winner is None else winner
    won = error.gather(1, winner[:, None])[:, 0]
    if nearest and predicted.shape[1] > 1:
        won = (1 - LOSERS_SHARE) * won + LOSERS_SHARE * error.mean(1)
    choice = F.cross_entropy(logits.float(), winner, reduction="none")
    total = weight.sum().clamp(min=1e-6)
    learnt = angle.gather(1, winner[:, None])[:, 0]
    return (weight * won).sum() / total, (weight * choice).sum() / total, learnt.detach()


def offset_loss(predicted: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Equation (5): relative L1 error of the offset vectors (P, 3) [m]."""
    relative = (predicted.float() - target).abs().sum(1) / (target.abs().sum(1) + OFFSET_EPSILON)
    return (weight * relative).sum() / weight.sum().clamp(min=1e-6)


def joint_loss(predicted: Tensor, target: Tensor, weight: Tensor) -> Tensor:
    """Mean squared error of joint angles (P, D) [rad^2], by their weights (P, D)."""
    squared = (predicted.float() - target).square()
    return (weight * squared).sum() / weight.sum().clamp(min=1e-6)


class Objective(nn.Module):
    """Equation (6) for one batch: the weighted sum of the losses, its terms, and a few readable errors.

    A module, so that DistributedDataParallel can wrap it.
    """

    def __init__(self, net: DGSNet, teacher: bool = True):
        """`teacher`: module II gets the labels' scores and rotations (paper); else module I's own."""
        super().__init__()
        self.net, self.teacher = net, teacher

    def forward(self, batch: TrainingBatch) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss, and its terms as tensors without gradient: reading them would make the host wait for a GPU.

        Module II sees the ground truth at the labelled voxels, one grasp drawn per voxel, and module I's rotation
        elsewhere.
        """
        one = self.net.module_one(batch.voxels)
        sixd, logits = one.rotation6d[batch.voxel], one.hypothesis_logits[batch.voxel]
        shape = None
        if isinstance(self.net.two, FixedShapes):
            shape = self.net.two.nearest(batch.j_init, batch.j_end)
        rotation, hypothesis, angle = rotation_loss(sixd, logits, batch.rotation, batch.weight, shape)
        two = self._module_two(one, batch, shape)
        chosen, rows, weight = batch.chosen, batch.voxel[batch.chosen], batch.weight[batch.chosen]
        of_joints = weight[:, None] * batch.touch[chosen]
        terms = {
            "score": score_loss(one.score_logits, batch.kind, batch.worth),
            "rotation": rotation,
            "hypothesis": hypothesis,
            "offset": offset_loss(two.offset[rows], batch.offset[chosen], weight),
            "j_init": joint_loss(two.j_init[rows], batch.j_init[chosen], of_joints),
            "j_end": joint_loss(two.j_end[rows], batch.j_end[chosen], of_joints),
        }
        total = sum((WEIGHTS[name] * term for name, term in terms.items()), angle.new_zeros(()))
        with torch.no_grad():
            values = {"loss": total, **terms, **readable_errors(one, two, batch, angle)}
            return total, {name: value.detach().float() for name, value in values.items()}

    def _module_two(
        self, one: ModuleOneOutput, batch: TrainingBatch, shape: Tensor | None
    ) -> ModuleTwoOutput:
        likeliest, rows = one.hypothesis_logits.argmax(1), batch.voxel[batch.chosen]
        if shape is not None:
            likeliest = likeliest.index_copy(0, rows, shape[batch.chosen])
            return self.net.module_two(one, likeliest, batch.voxels)
        fed, score = rotation_of(one, likeliest).detach().float(), one.score_logits.detach()
        if self.teacher:
            fed = fed.index_copy(0, rows, sixd_from_matrix(batch.rotation[batch.chosen]))
            score = teacher_logits(graspable(batch.kind))
        dtype = one.features.dtype
        level = batch.voxels.levels[0]
        return self.net.two(one.features, score.to(dtype), fed.to(dtype), level)


def readable_errors(
    one: ModuleOneOutput, two: ModuleTwoOutput, batch: TrainingBatch, angle: Tensor
) -> dict[str, Tensor]:
    """Precision and recall of the points, median errors of angle [deg] and offset [mm], mean error of joints [rad].

    Args:
        angle: (P,) errors of the nearest hypothesis [rad].

    Returns:
        0-dimensional tensors; NaN where the batch has no label.
    """
    predicted, positive = one.score_logits.argmax(1) > 0, graspable(batch.kind)
    hits = (predicted & positive).sum()
    rows, touch = batch.voxel[batch.chosen], batch.touch[batch.chosen]
    return {
        "precision": hits / predicted.sum().clamp(min=1),
        "recall": hits / positive.sum().clamp(min=1),
        "angle_deg": torch.rad2deg(angle).median(),
        "offset_mm": (two.offset[rows] - batch.offset[batch.chosen]).norm(dim=1).median() * 1e3,
        "j_end_rad": ((two.j_end[rows] - batch.j_end[batch.chosen]).abs() * touch).sum() / touch.sum(),
    }
