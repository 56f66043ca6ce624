"""`dgs bench-inference`: the time from a cloud to checked grasps, by stage, on a fixed scene."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from dgs_learning import paths
from dgs_learning.cli.refusal import refusals

if TYPE_CHECKING:
    from dgs_grasp_planner.planner import GraspPlanner
    from dgs_learning.cli.bench_beside import OtherNetwork


def bench_inference(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the numbers here.")] = None,
    threads: Annotated[int, typer.Option(min=0, help="Torch threads; 0 = all cores.")] = 0,
    repeat: Annotated[int, typer.Option(min=1, help="Measured calls.")] = 30,
    warm_up: Annotated[int, typer.Option(min=1, help="Calls before them that do not count.")] = 5,
    voxels: Annotated[
        str, typer.Option(help="Also measure smaller scenes of so many voxels: 1000,2000,4000.")
    ] = "",
    model: Annotated[str, typer.Option(help="Name of the weights.")] = "dgs_net",
    models_dir: Annotated[Path | None, typer.Option(help="Where the weights lie.")] = None,
    device: Annotated[str, typer.Option(help="cpu, cuda or auto.")] = "cpu",
    precision: Annotated[str, typer.Option(help="fp32, bf16 or auto.")] = "auto",
    beside: Annotated[
        str,
        typer.Option(help="Another network to time in turn with ours: MODULE:FUNCTION of points, features."),
    ] = "",
) -> None:
    """Time from a 20 000-point cloud to checked grasps: median and 90th percentile after warm-up."""
    from dgs_learning.cli.bench_beside import load_function

    with refusals():
        counts = _counts(voxels)
        other = load_function(beside) if beside else None
        measured = measure(
            models_dir or paths.models_dir(),
            model,
            (device, precision),
            threads,
            (warm_up, repeat),
            counts,
            other,
        )
    for line in lines(measured):
        typer.echo(line)
    if json_file is not None:
        json_file.parent.mkdir(parents=True, exist_ok=True)
        json_file.write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")


def _counts(text: str) -> list[int]:
    from dgs_description.errors import DgsError, ErrorCode

    try:
        counts = [int(word) for word in text.split(",") if word]
    except ValueError:
        counts = [0]
    if any(count < 100 for count in counts):
        raise DgsError(
            ErrorCode.REQUEST_INVALID, f"voxels {text!r}: numbers of at least 100, separated by commas"
        )
    return counts


def measure(
    directory: Path,
    model: str,
    where: tuple[str, str],
    threads: int,
    calls: tuple[int, int],
    voxel_counts: list[int],
    other: OtherNetwork | None = None,
) -> dict[str, Any]:
    """Measure a model.

    Args:
        directory: of the weights.
        model: their name.
        where: device and precision.
        threads: torch threads, 0 = all cores.
        calls: number of warm-up calls and of measured ones.
        voxel_counts: smaller scenes to measure as well.
        other: a network to time in turn with this one on the same points.

    Returns:
        JSON-ready numbers; times in seconds.

    Raises:
        DgsError: WEIGHTS_MISSING, WEIGHTS_ALTERED.
    """
    from dgs_grasp_planner.runtime import prepare_process

    prepare_process()
    import torch

    from dgs_grasp_planner.load import load_planner
    from dgs_grasp_planner.preprocess import prepare_rows
    from dgs_grasp_planner.propose.dgs_net import DgsNet
    from dgs_learning.cli.bench_beside import time_beside
    from dgs_learning.cli.bench_scene import POINTS, bench_scene, nearest_voxels
    from dgs_learning.cli.machine import describe_machine
    from dgs_learning.evaluation.provenance import revision, today

    machine = describe_machine("cuda" if where[0] != "cpu" and torch.cuda.is_available() else "cpu")
    torch.set_num_threads(threads or machine["cores"])
    planner = load_planner(directory, model, device=where[0], precision=where[1])
    network = planner.proposers[0]
    assert isinstance(network, DgsNet)
    net, info = network.net, network.info
    scene = bench_scene()
    size = net.config.voxel_size
    whole = _timed(planner, scene.cloud, scene.camera, calls)
    # Of the points that the planner would take: dropping table points must not change the number of voxels again.
    taken = scene.cloud[prepare_rows(scene.cloud, np.random.default_rng(0), planner.settings.cloud)]
    sweep = [_timed(planner, nearest_voxels(taken, size, n), scene.camera, calls) for n in voxel_counts]
    weight = net.one.score.out.weight
    assert info is not None
    return {
        **whole,
        **(
            {}
            if other is None
            else {"beside": time_beside(planner, network, taken, scene.camera, other, calls)}
        ),
        "points_wanted": POINTS,
        "warm_up": calls[0],
        "repeat": calls[1],
        "threads": torch.get_num_threads(),
        "device": weight.device.type,
        "precision": str(weight.dtype).removeprefix("torch."),
        "voxel_size": size,
        "model": {
            "id": info.model_id,
            "sha256": info.sha256,
            "parameters": net.parameter_count,
            "config": net.config.name,
        },
        "sweep": sweep,
        "machine": machine,
        "revision": revision(),
        "date": today(),
    }


def _timed(
    planner: GraspPlanner, cloud: np.ndarray, camera: np.ndarray, calls: tuple[int, int]
) -> dict[str, Any]:
    """Medians and 90th percentiles of repeated calls with the same seed."""
    warm_up, repeat = calls
    runs, prediction = [], None
    for call in range(warm_up + repeat):
        prediction = planner(cloud, camera, np.random.default_rng(0))
        if call >= warm_up:
            runs.append(prediction.stage_times)
    assert prediction is not None
    names = [name for name in dict.fromkeys(name for run in runs for name in run) if name != "total"]
    stages = {name: np.array([run.get(name, 0.0) for run in runs]) for name in names}
    total = np.array([run["total"] for run in runs])
    network = stages["network"]
    return {
        "total_s": _rounded(np.median(total)),
        "total_p90_s": _rounded(np.percentile(total, 90)),
        "network_s": _rounded(np.median(network)),
        "network_p90_s": _rounded(np.percentile(network, 90)),
        "stages": {name: _rounded(np.median(values)) for name, values in stages.items()},
        "stages_p90": {name: _rounded(np.percentile(values, 90)) for name, values in stages.items()},
        "points_in": len(cloud),
        "points_used": prediction.points_used,
        "voxels": _voxels(planner, cloud),
        "grasps": len(prediction.grasps),
    }


def _voxels(planner: GraspPlanner, cloud: np.ndarray) -> int:
    from dgs_grasp_planner.preprocess import prepare_rows
    from dgs_grasp_planner.scene import VOXEL

    rows = prepare_rows(cloud, np.random.default_rng(0), planner.settings.cloud)
    return len(np.unique(np.floor(cloud[rows] / VOXEL).astype(np.int64), axis=0))


def _rounded(seconds: float) -> float:
    return round(float(seconds), 6)


def lines(measured: dict[str, Any]) -> list[str]:
    """The numbers for people, in milliseconds."""
    machine, model = measured["machine"], measured["model"]
    where = (
        machine["gpu"] or f"{machine['processor']}, {measured['threads']} threads of {machine['cores']} cores"
    )
    out = [
        f"model {model['id']} ({model['config']}, {model['parameters'] / 1e6:.1f} M, {model['sha256'][:12]}), "
        f"{measured['precision']} on {where}, torch {machine['torch']}, load {machine['load_average']}",
        f"{measured['points_used']} of {measured['points_in']} points in {measured['voxels']} voxels -> "
        f"{measured['grasps']} grasps; median of {measured['repeat']} calls after {measured['warm_up']}",
        f"{'stage':12s} {'median':>9s} {'p90':>9s}  [ms]",
    ]
    rows = [(name, measured["stages"][name], measured["stages_p90"][name]) for name in measured["stages"]]
    rows.append(("network_s", measured["network_s"], measured["network_p90_s"]))
    rows.append(("total", measured["total_s"], measured["total_p90_s"]))
    out += [f"{name:12s} {median * 1e3:9.1f} {p90 * 1e3:9.1f}" for name, median, p90 in rows]
    if "beside" in measured:
        both = measured["beside"]
        out.append(
            f"beside {both['name']}: {both['other_s'] * 1e3:.0f} ms, this network {both['network_s'] * 1e3:.0f} ms on "
            f"the same {both['points']} points, ratio {both['ratio']:.2f} (median of {both['repeat']} pairs)"
        )
    for part in measured["sweep"]:
        out.append(
            f"{part['voxels']:6d} voxels  total {part['total_s'] * 1e3:7.1f}  network {part['network_s'] * 1e3:7.1f}"
        )
    if machine["load_average"] > 0.5 * machine["cores"]:
        out.append("note: the machine was busy with other work; the times are too long")
    return out
