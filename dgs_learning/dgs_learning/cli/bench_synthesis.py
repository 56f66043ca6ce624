"""`dgs bench-synthesis`: the rate of the grasp synthesis and the cost of training views."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer


def bench_synthesis(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the numbers here.")] = None,
    per_class: Annotated[int, typer.Option(min=1, help="Objects of every class.")] = 2,
    trials: Annotated[int, typer.Option(min=1, help="Simulated candidates per resting pose.")] = 10,
    views: Annotated[int, typer.Option(min=1, help="Training views.")] = 20,
    images: Annotated[int, typer.Option(min=1, help="Depth images compared with PyBullet's camera.")] = 8,
    dataset: Annotated[Path | None, typer.Option(help="Dataset file whose scenes are rendered.")] = None,
) -> None:
    """Validated grasps per second and core, time per trial by stage, time per view, agreement of its depth."""
    from dgs_learning.cli.files import existing_dataset, write_json
    from dgs_learning.cli.machine import measured_here
    from dgs_learning.dataset import load_dataset
    from dgs_learning.synthesis import measure

    data = load_dataset(existing_dataset(dataset))
    measured = {
        **measured_here(),
        "setting": {"per_class": per_class, "trials": trials, "views": views, "images": images, "seed": 0},
        "time": "processor time of one process",
        "stage1": measure.measure_grasps(per_class, trials),
        "views": measure.measure_views(data, views),
        "depth_against_pybullet": measure.compare_depth(data, images),
    }
    for line in lines(measured):
        typer.echo(line)
    write_json(json_file, measured)


def lines(measured: dict[str, Any]) -> list[str]:
    """The numbers as text."""
    one, depth = measured["stage1"], measured["depth_against_pybullet"]
    rates = ", ".join(f"{name} {row['grasps_per_core_second']:.2f}" for name, row in one["by_class"].items())
    stages = ", ".join(f"{name} {ms:.1f}" for name, ms in one["stage_ms_per_trial"].items())
    text = [
        f"stage 1: {one['grasps_per_core_second']:.2f} validated grasps per core and second ({rates})",
        f"  {one['trials']} trials, {100 * one['share_of_trials_kept']:.0f} % kept, ms per trial: {stages}",
    ]
    text += [
        f"view, {name.replace('_', ' ')}: {row['median_ms']:.0f} ms for {row['points']:.0f} points"
        for name, row in measured["views"].items()
    ]
    text.append(f"depth within 1 mm of PyBullet's camera: {100 * depth['share_within_1_mm']:.2f} % of pixels")
    return text
