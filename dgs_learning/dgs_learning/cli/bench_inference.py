"""`dgs bench-inference`: the time from a cloud to checked grasps, by stage, on a fixed scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from dgs_learning import paths
from dgs_learning.cli.files import put_out
from dgs_learning.cli.options import Device, Json, Model, ModelsDir

if TYPE_CHECKING:
    from dgs_grasp_planner.planner import GraspPlanner


def bench_inference(
    json_file: Json = None,
    threads: Annotated[int, typer.Option(min=0, help="Torch threads; 0 = all cores.")] = 0,
    repeat: Annotated[int, typer.Option(min=1, help="Measured calls.")] = 30,
    warm_up: Annotated[int, typer.Option(min=1, help="Calls before them that do not count.")] = 5,
    model: Model = "dgs_net",
    models_dir: ModelsDir = None,
    device: Device = "cpu",
    precision: Annotated[str, typer.Option(help="fp32, bf16 or auto.")] = "auto",
) -> None:
    """Time from a 20 000-point cloud to checked grasps: median and 90th percentile after warm-up."""
    from dgs_grasp_planner.runtime import prepare_process

    prepare_process()
    import torch

    from dgs_grasp_planner.load import load_planner
    from dgs_learning.cli.machine import measured_here

    here = measured_here("cuda" if device != "cpu" and torch.cuda.is_available() else "cpu")
    torch.set_num_threads(threads or here["machine"]["cores"])
    planner = load_planner(models_dir or paths.weights_dir(), model, device=device, precision=precision)
    measured = {**measure(planner, warm_up, repeat), **here}
    put_out("inference.txt", measured, json_file)


def measure(planner: GraspPlanner, warm_up: int, repeat: int) -> dict[str, Any]:
    """Medians and 90th percentiles of calls of a planner of `load_planner` with the same seed; JSON-ready, times [s].

    Args:
        warm_up: calls that do not count, before `repeat` measured ones.
    """
    import torch

    from dgs_grasp_planner.preprocess import prepare_rows
    from dgs_grasp_planner.propose.dgs_net import DgsNet
    from dgs_grasp_planner.scene import VOXEL
    from dgs_learning.cli.bench_scene import bench_scene

    network, (cloud, camera) = planner.proposers[0], bench_scene()
    assert isinstance(network, DgsNet) and network.info is not None
    net, info = network.net, network.info
    predictions = [planner(cloud, camera, np.random.default_rng(0)) for _ in range(warm_up + repeat)]
    runs = [prediction.stage_times for prediction in predictions[warm_up:]]
    names = dict.fromkeys(name for run in runs for name in run)
    times = np.array([[run.get(name, 0.0) for name in names] for run in runs])
    shares = np.percentile(times, (50, 90), axis=0).round(6).tolist()
    median, p90 = (dict(zip(names, row, strict=True)) for row in shares)
    rows = prepare_rows(cloud, np.random.default_rng(0), keep_table=planner.settings.keep_table)
    return {
        "total_s": median.pop("total"),
        "total_p90_s": p90.pop("total"),
        "network_s": median["network"],
        "network_p90_s": p90["network"],
        "stages": median,
        "stages_p90": p90,
        "points_in": len(cloud),
        "points_used": predictions[-1].points_used,
        "voxels": len(np.unique(np.floor(cloud[rows] / VOXEL).astype(np.int64), axis=0)),
        "grasps": len(predictions[-1].grasps),
        "warm_up": warm_up,
        "repeat": repeat,
        "threads": torch.get_num_threads(),
        "device": network.device.type,
        "precision": str(net.one.score.out.weight.dtype).removeprefix("torch."),
        "voxel_size": net.config.voxel_size,
        "model": {
            "id": info.model_id,
            "sha256": info.sha256,
            "parameters": net.parameter_count,
            "config": net.config.name,
        },
    }
