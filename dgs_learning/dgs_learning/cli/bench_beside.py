"""Times another point-cloud network in turn with DGS-Net, on the same points and threads, in one process."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dgs_description.errors import DgsError, ErrorCode

if TYPE_CHECKING:
    import torch

    from dgs_grasp_planner.planner import GraspPlanner
    from dgs_grasp_planner.propose.dgs_net import DgsNet


@dataclass(frozen=True)
class OtherNetwork:
    """What to compare with.

    Attributes:
        name: MODULE:FUNCTION.
        run: called with points (N, 3) [m] and features (N, F), float32 tensors; its result is not looked at.
    """

    name: str
    run: Callable[[torch.Tensor, torch.Tensor], Any]


def load_function(name: str) -> OtherNetwork:
    """The function that `MODULE:FUNCTION` names.

    Raises:
        DgsError: REQUEST_INVALID, there is no such module or function.
    """
    module, _, function = name.partition(":")
    try:
        run = getattr(import_module(module), function)
    except (ImportError, ValueError, AttributeError) as error:
        raise DgsError(
            ErrorCode.REQUEST_INVALID, f"--beside {name!r} is no MODULE:FUNCTION: {error}"
        ) from error
    if not callable(run):
        raise DgsError(ErrorCode.REQUEST_INVALID, f"--beside {name!r} is not a function")
    return OtherNetwork(name, run)


def time_beside(
    planner: GraspPlanner,
    network: DgsNet,
    points: NDArray[np.float32],
    camera: ArrayLike,
    other: OtherNetwork,
    calls: tuple[int, int],
) -> dict[str, Any]:
    """Both networks, one call each in turn.

    Ours counts with everything between points and outputs: voxels and neighbour tables, module I, module II at the
    points that are decoded (stages `geometry` and `network` of the planner).

    Args:
        planner, network: ours.
        points: (N, 3) in the table frame [m], as the planner takes them after its preparation.
        camera: (3,) its position there [m].
        other: the other network.
        calls: number of warm-up calls and of measured ones.

    Returns:
        JSON-ready medians in seconds: network_s, network_cpu_s, other_s, other_cpu_s and their ratios.

    Raises:
        DgsError: REQUEST_INVALID, the other network failed.
    """
    import torch

    from dgs_grasp_planner.network import input_features

    xyz = torch.from_numpy(np.ascontiguousarray(points, dtype=np.float32))
    features = input_features(
        xyz, torch.as_tensor(np.asarray(camera), dtype=torch.float32), network.net.config
    )
    warm_up, repeat = calls
    rows = []
    for call in range(warm_up + repeat):
        computed = time.process_time()
        stages = planner(points, camera, np.random.default_rng(0)).stage_times
        ours_cpu, total = time.process_time() - computed, stages["total"]
        ours = sum(stages.get(name, 0.0) for name in ("geometry", "network"))
        started, computed = time.perf_counter(), time.process_time()
        try:
            other.run(xyz, features)
        except Exception as error:  # anything may be wrong in a function that is not ours
            raise DgsError(
                ErrorCode.REQUEST_INVALID, f"{other.name} failed on the points: {error}"
            ) from error
        theirs, theirs_cpu = time.perf_counter() - started, time.process_time() - computed
        if call >= warm_up:
            rows.append((ours, ours_cpu * ours / total, theirs, theirs_cpu))
    ours_s, ours_cpu_s, theirs_s, theirs_cpu_s = np.median(rows, axis=0).tolist()
    return {
        "name": other.name,
        "points": len(points),
        "repeat": repeat,
        "network_s": round(ours_s, 6),
        "network_cpu_s": round(ours_cpu_s, 6),
        "other_s": round(theirs_s, 6),
        "other_cpu_s": round(theirs_cpu_s, 6),
        "ratio": round(ours_s / theirs_s, 4),
        "ratio_cpu": round(ours_cpu_s / theirs_cpu_s, 4),
        "ratio_p90": round(float(np.percentile([row[0] / row[2] for row in rows], 90)), 4),
    }
