"""Times another point-cloud network in turn with DGS-Net, on the same points and threads, in one process."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode

if TYPE_CHECKING:
    import torch

    from dgs_grasp_planner.planner import GraspPlanner


_refused = partial(DgsError, ErrorCode.REQUEST_INVALID)


def load_function(name: str) -> Callable[[torch.Tensor, torch.Tensor], Any]:
    """The function that `MODULE:FUNCTION` names: of points (N, 3) [m] and features (N, F), float32 tensors.

    Raises:
        DgsError: REQUEST_INVALID, there is no such module or function.
    """
    try:
        run = resolve_name(name)
    except (ImportError, ValueError, AttributeError) as error:
        raise _refused(f"--beside {name!r} is no MODULE:FUNCTION: {error}") from error
    if not callable(run):
        raise _refused(f"--beside {name!r} is not a function")
    return run  # type: ignore[no-any-return]


def time_beside(
    planner: GraspPlanner,
    features: torch.Tensor,
    points: NDArray[np.float32],
    camera: NDArray,
    name: str,
    calls: tuple[int, int],
) -> dict[str, Any]:
    """Both networks, one call each in turn.

    Ours counts with everything between points and outputs: voxels and neighbour tables, module I, module II at the
    points that are decoded (stages `geometry` and `network` of the planner).

    Args:
        features: (N, F) of the points.
        points: (N, 3) in the table frame [m], as the planner takes them after its preparation.
        camera: (3,) its position there [m].
        name: MODULE:FUNCTION of the other network; its result is not looked at.
        calls: number of warm-up calls and of measured ones.

    Returns:
        JSON-ready medians in seconds: network_s, network_cpu_s, other_s, other_cpu_s and their ratios.

    Raises:
        DgsError: REQUEST_INVALID, the other network failed.
    """
    import torch

    other, xyz = load_function(name), torch.from_numpy(points)
    rows = []
    for _ in range(sum(calls)):
        computed = time.process_time()
        stages = planner(points, camera, np.random.default_rng(0)).stage_times
        ours_cpu = time.process_time() - computed
        ours = stages.get("geometry", 0.0) + stages.get("network", 0.0)
        started, computed = time.perf_counter(), time.process_time()
        try:
            other(xyz, features)
        except Exception as error:  # anything may be wrong in a function that is not ours
            raise _refused(f"{name} failed on the points: {error}") from error
        theirs = time.perf_counter() - started, time.process_time() - computed
        rows.append((ours, ours_cpu * ours / stages["total"], *theirs))
    measured = np.array(rows[calls[0] :])
    names = ("network_s", "network_cpu_s", "other_s", "other_cpu_s")
    ours_s, ours_cpu_s, theirs_s, theirs_cpu_s = medians = np.median(measured, axis=0).tolist()
    return {
        "name": name,
        "points": len(points),
        "repeat": calls[1],
        **{key: round(value, 6) for key, value in zip(names, medians, strict=True)},
        "ratio": round(ours_s / theirs_s, 4),
        "ratio_cpu": round(ours_cpu_s / theirs_cpu_s, 4),
        "ratio_p90": round(float(np.percentile(measured[:, 0] / measured[:, 2], 90)), 4),
    }
