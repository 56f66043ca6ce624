"""DGS-Net as a proposer: reference points by score and spatial NMS, and for each its likeliest rotations."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet, non_maximum_suppression
from dgs_grasp_planner.network import DGSNet, ModelInfo, VoxelBatch, collate, input_features, load_network
from dgs_grasp_planner.network.decode import SOURCE, grasps_from_outputs, rank_hypotheses, softmax
from dgs_grasp_planner.network.dgs_net import rotation_of
from dgs_grasp_planner.network.input_frame import table_from_input
from dgs_grasp_planner.network.module_one import ModuleOneOutput
from dgs_grasp_planner.runtime import choose_device, choose_dtype, pairs_pay
from dgs_grasp_planner.scene import Scene

SCORE_THRESHOLD = 0.7
"""Points below it are no reference points, unless the request says otherwise (paper: 0.7)."""
APART, REFERENCE_POINTS = 0.025, 32
"""Between reference points [m]; at most so many."""
HYPOTHESES = 3
"""Rotations tried per reference point, at most as many as the network has."""
CANDIDATES, USUAL_WISH = 48, 128
"""So many of the best are proposed; who wants more grasps than the latter gets as many times more reference points and
candidates."""


class DgsNet:
    """The network. Not for concurrent calls; the same points give the same answer.

    Attributes:
        net: on its device and in its dtype.
        score_threshold: of reference points.
        info: what the weights file said, None for a network that comes from no file.
    """

    name = SOURCE

    def __init__(self, net: DGSNet, score_threshold: float = SCORE_THRESHOLD, info: ModelInfo | None = None):
        """Take a network over for inference."""
        self.net, self.score_threshold, self.info = net.eval(), score_threshold, info
        weight = net.one.score.out.weight
        self.device, self._dtype = weight.device, weight.dtype

    @classmethod
    def from_weights(
        cls,
        directory: Path | str,
        model: str,
        score_threshold: float = SCORE_THRESHOLD,
        device: str = "cpu",
        precision: str = "auto",
    ) -> DgsNet:
        """Load a model; see `network.weights.load_network` for what is checked and raised.

        Args:
            directory: folder of `<model>.pt` and `<model>.json`.
            model: its name.
            score_threshold: of reference points.
            device: `cpu`, `cuda` or `auto`.
            precision: `fp32`, `bf16` or `auto`.

        Raises:
            DgsError: also as `choose_device`.
        """
        target = choose_device(device)
        net, info = load_network(directory, model, target, choose_dtype(precision, target))
        return cls(net, score_threshold, info)

    def warm_up(self) -> float:
        """Run once on a made-up scene so that the first real call is not the slow one; returns the seconds it took."""
        rng = np.random.default_rng(0)
        table = rng.uniform((-0.2, -0.3, 0.0), (0.2, 0.3, 0.001), (12_000, 3))
        block = rng.uniform((-0.04, -0.04, 0.0), (0.04, 0.04, 0.08), (4_000, 3))
        start = time.perf_counter()
        self(Scene(np.concatenate([table, block]).astype(np.float32), np.array([0.47, 0.0, 0.88]), rng))
        return time.perf_counter() - start

    @torch.inference_mode()
    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates, best first; their score is the point's times the weight of the rotation."""
        T_table_input = table_from_input(self.net.config.frame, scene.camera)
        batch, one = scene.once(self._seen)
        centres = _numpy(batch.centres) @ T_table_input[:3, :3].T + T_table_input[:3, 3]
        with scene.clock("network"):
            score = self.point_score(one, centres, scene)
            rows = self._reference_rows(centres, score, scene)
            if not len(rows):
                return GraspSet.empty()
            hypotheses = min(HYPOTHESES, self.net.config.rotation_hypotheses)
            order, weight = rank_hypotheses(_numpy(one.hypothesis_logits), hypotheses)
            answers = [self._module_two(one, batch, rows, order[:, rank]) for rank in range(hypotheses)]
        with scene.clock("decode"):
            rotation, offset, j_init, j_end = (
                np.concatenate([_numpy(answer[i]) for answer in answers]) for i in range(4)
            )
            grasps = grasps_from_outputs(
                reference_point=np.tile(_numpy(batch.centres)[rows], (hypotheses, 1)),
                score=(score[rows] * weight[rows].T).ravel(),
                rotation6d=rotation,
                offset=offset,
                j_init=j_init,
                j_end=j_end,
            )
            return grasps[: round(CANDIDATES * _measure(scene))].moved(T_table_input)

    def _seen(self, scene: Scene) -> tuple[VoxelBatch, ModuleOneOutput]:
        """The voxels, and what module I says of each."""
        with scene.clock("geometry"):
            batch = self._batch(scene, table_from_input(self.net.config.frame, scene.camera))
        with scene.clock("network"):
            return batch, self.net.module_one(batch)

    def point_score(self, one: ModuleOneOutput, centres: Array, scene: Scene) -> Array:
        """(V,) how good a reference point each voxel is, in [0, 1]: what the network says.

        Args:
            one: module I's answer.
            centres: (V, 3) of the voxels, frame *table* [m].
            scene: where they were seen.
        """
        return softmax(_numpy(one.score_logits))[:, 1]

    def _reference_rows(self, centres: Array, score: Array, scene: Scene) -> NDArray[np.int64]:
        """Of the voxels that become reference points, best first."""
        wanted = scene.request.min_score
        threshold = self.score_threshold if wanted is None else wanted
        rows = np.flatnonzero(scene.request.wanted(centres) & (score > threshold))
        limit = round(REFERENCE_POINTS * _measure(scene))
        return rows[non_maximum_suppression(centres[rows], score[rows], APART, limit)]

    def _module_two(
        self, one: ModuleOneOutput, batch: VoxelBatch, rows: NDArray[np.int64], hypothesis: NDArray[np.int64]
    ) -> tuple[torch.Tensor, ...]:
        """Rotation (S, 6), offset (S, 3), J_init and J_end (S, D) at `rows`, with one rotation per voxel."""
        which, chosen = torch.from_numpy(hypothesis).to(self.device), torch.from_numpy(rows).to(self.device)
        return rotation_of(one, which)[chosen], *self.net.module_two(one, which, batch, chosen)

    def _batch(self, scene: Scene, T_table_input: Array) -> VoxelBatch:
        shift = (scene.points - T_table_input[:3, 3]) @ T_table_input[:3, :3]
        camera = (scene.camera - T_table_input[:3, 3]) @ T_table_input[:3, :3]
        xyz = torch.from_numpy(np.ascontiguousarray(shift, dtype=np.float32))
        features = input_features(xyz, torch.from_numpy(camera).float(), self.net.config)
        batch = collate([xyz], [features], self.net.config, with_pairs=pairs_pay(self.device, self._dtype))
        return batch.to(self.device, self._dtype)


def _measure(scene: Scene) -> float:
    return max((scene.request.max_grasps or 0) / USUAL_WISH, 1.0)


def _numpy(values: torch.Tensor) -> Array:
    return values.double().cpu().numpy()
