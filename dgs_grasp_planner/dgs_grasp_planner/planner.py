"""DGS-Net as a plain callable: cloud in, checked grasps out. Shared by node, evaluation and command line."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from dgs_description.grasp import NO_WISHES, GraspSet, PlanRequest, Prediction
from dgs_grasp_planner.checks import CheckConfig, check_grasps
from dgs_grasp_planner.contact.fit import RefineConfig, refine
from dgs_grasp_planner.network import DGSNet, ModelInfo, VoxelBatch, collate, input_features, load_network
from dgs_grasp_planner.network.decode import (
    DecodeConfig,
    grasps_from_outputs,
    rank_hypotheses,
    reference_rows,
    softmax,
)
from dgs_grasp_planner.network.input_frame import table_from_input
from dgs_grasp_planner.network.module_one import ModuleOneOutput
from dgs_grasp_planner.preprocess import CloudSettings, prepare_rows
from dgs_grasp_planner.runtime import choose_device, choose_dtype

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlannerConfig:
    """Settings of all stages."""

    cloud: CloudSettings = field(default_factory=CloudSettings)
    decode: DecodeConfig = field(default_factory=DecodeConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    checks: CheckConfig = field(default_factory=CheckConfig)
    max_grasps: int = 32


class StageClock:
    """Seconds per named stage."""

    def __init__(self) -> None:
        self.times: dict[str, float] = {}
        self._start = time.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to stage `name`."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.times[name] = self.times.get(name, 0.0) + time.perf_counter() - start

    def finish(self) -> dict[str, float]:
        """The stages and `total`."""
        return {**self.times, "total": time.perf_counter() - self._start}


class DgsNetPlanner:
    """The planner. Not for concurrent calls; the same cloud and seed give the same answer."""

    def __init__(self, net: DGSNet, config: PlannerConfig | None = None, info: ModelInfo | None = None):
        """Take a network over for inference.

        Args:
            net: on its device and in its dtype.
            config: settings of all stages.
            info: what the weights file said.
        """
        self.net = net.eval()
        chosen = config or PlannerConfig()
        self.config = replace(chosen, cloud=replace(chosen.cloud, keep_table=net.config.keep_table))
        self.info = info
        weight = net.one.score.out.weight
        self._device, self._dtype = weight.device, weight.dtype

    @classmethod
    def from_weights(
        cls,
        directory: Path | str,
        name: str,
        config: PlannerConfig | None = None,
        device: str = "cpu",
        precision: str = "auto",
    ) -> DgsNetPlanner:
        """Load a model; see `network.weights.load_network` for what is checked and raised.

        Args:
            directory: folder of `<name>.pt` and `<name>.json`.
            name: of the model.
            config: settings.
            device: `cpu`, `cuda` or `auto`.
            precision: `fp32`, `bf16` or `auto`.
        """
        target = choose_device(device)
        net, info = load_network(directory, name, target, choose_dtype(precision, target))
        return cls(net, config, info)

    def warm_up(self) -> float:
        """Run once on a made-up scene so that the first real call is not the slow one; returns the seconds it took."""
        rng = np.random.default_rng(0)
        table = rng.uniform((-0.2, -0.3, 0.0), (0.2, 0.3, 0.001), (12_000, 3))
        block = rng.uniform((-0.04, -0.04, 0.0), (0.04, 0.04, 0.08), (4_000, 3))
        start = time.perf_counter()
        self(np.concatenate([table, block]).astype(np.float32), (0.47, 0.0, 0.88), rng)
        return time.perf_counter() - start

    @torch.inference_mode()
    def __call__(
        self,
        cloud: NDArray[np.float32],
        camera_position: ArrayLike,
        rng: np.random.Generator,
        request: PlanRequest = NO_WISHES,
    ) -> Prediction:
        """Grasps for the objects in one cloud.

        Args:
            cloud: (N, 3) [m] in the table frame.
            camera_position: (3,) [m] in the table frame.
            rng: decides which points are sampled.
            request: wishes of this call.

        Returns:
            Grasps in the table frame, best first; none if nothing scored high enough or all were rejected.

        Raises:
            DgsError: CLOUD_FORMAT, CLOUD_EMPTY, CLOUD_NOT_FINITE, NO_OBJECTS.
        """
        clock = StageClock()
        with clock.stage("preprocess"):
            points = np.asarray(cloud, np.float32)[prepare_rows(cloud, rng, self.config.cloud)]
            T_table_input = table_from_input(self.net.config.frame, camera_position)
        with clock.stage("geometry"):
            batch = self._batch(points, camera_position, T_table_input)
            centres = _in_table(batch.centres, T_table_input)
        with clock.stage("network"):
            one = self.net.module_one(batch)
            if self._device.type == "cuda":
                torch.cuda.synchronize(self._device)  # else the next stage's time would hold this one's
        limit = self.config.max_grasps if request.max_grasps is None else request.max_grasps
        for threshold in self._thresholds(request):
            candidates = self._candidates(one, batch, centres, T_table_input, request, threshold, clock)
            with clock.stage("contact"):
                camera = np.asarray(camera_position, np.float64)
                candidates = refine(candidates, points, camera, self.config.refine, request)
            with clock.stage("checks"):
                result = check_grasps(candidates, centres, self.config.checks)
                grasps = result.grasps.select(np.flatnonzero(result.accepted)[:limit])
            if not grasps.proposed.all():  # else the network's doubtful grasps may be of other things
                break
        return Prediction(grasps, int(points.shape[0]), clock.finish(), result.counts())

    def _batch(
        self, points: NDArray[np.float32], camera_position: ArrayLike, T_table_input: Array
    ) -> VoxelBatch:
        shift = (points - T_table_input[:3, 3]) @ T_table_input[:3, :3]
        camera = (np.asarray(camera_position, np.float64) - T_table_input[:3, 3]) @ T_table_input[:3, :3]
        xyz = torch.from_numpy(np.ascontiguousarray(shift, dtype=np.float32))
        features = input_features(xyz, torch.from_numpy(camera).float(), self.net.config)
        batch = collate([xyz], [features], self.net.config, with_pairs=self._device.type == "cpu")
        return batch.to(self._device, self._dtype)

    def point_score(self, one: ModuleOneOutput, centres: Array) -> Array:
        """(V,) how good a reference point each voxel is, in [0, 1]: what the network says.

        Args:
            one: module I's answer.
            centres: (V, 3) of the voxels, frame *table* [m].
        """
        return softmax(_numpy(one.score_logits))[:, 1]

    def _thresholds(self, request: PlanRequest) -> tuple[float, ...]:
        """The score that reference points need; a lower one follows for the case that no grasp above it survives."""
        decode = self.config.decode
        if request.min_score is not None:
            return (request.min_score,)
        if decode.fallback_threshold < decode.score_threshold:
            return decode.score_threshold, decode.fallback_threshold
        return (decode.score_threshold,)

    def _candidates(
        self,
        one: ModuleOneOutput,
        batch: VoxelBatch,
        centres: Array,
        T_table_input: Array,
        request: PlanRequest,
        threshold: float,
        clock: StageClock,
    ) -> GraspSet:
        with clock.stage("decode"):
            score = self.point_score(one, centres)
            decode = replace(self.config.decode, score_threshold=threshold)
            allowed = (
                np.ones(len(score), bool) if request.region is None else request.region.contains(centres)
            )
            rows = reference_rows(centres, score, allowed, decode)
            hypotheses = min(decode.hypotheses, self.net.config.rotation_hypotheses)
            order, weight = rank_hypotheses(_numpy(one.hypothesis_logits), hypotheses)
        if len(rows) == 0:
            return GraspSet.empty()
        parts = []
        with clock.stage("refine"):
            chosen = torch.from_numpy(rows).to(self._device)
            for rank in range(hypotheses):
                which = torch.from_numpy(order[:, rank]).to(self._device)
                sixd = one.rotation6d.gather(1, which[:, None, None].expand(-1, 1, 6))[:, 0]
                two = self.net.module_two(one.features, one.score_logits, sixd, batch, chosen)
                parts.append((score[rows] * weight[rows, rank], sixd[chosen], *two))
        with clock.stage("decode"):
            columns = [np.concatenate([_numpy(part[i]) for part in parts]) for i in range(5)]
            reference = np.tile(_numpy(batch.centres)[rows], (hypotheses, 1))
            return request.admitted(grasps_from_outputs(reference, *columns).moved(T_table_input))


def _numpy(values: torch.Tensor | NDArray) -> Array:
    return values.double().cpu().numpy() if isinstance(values, torch.Tensor) else values


def _in_table(centres: torch.Tensor, T_table_input: Array) -> Array:
    return _numpy(centres) @ T_table_input[:3, :3].T + T_table_input[:3, 3]
