"""`dgs bench-synthesis`: the rate of the grasp synthesis and the cost of training views."""

from __future__ import annotations

from typing import Annotated

import typer

from dgs_learning.cli.options import Dataset, Json


def bench_synthesis(
    json_file: Json = None,
    per_class: Annotated[int, typer.Option(min=1, help="Objects of every class.")] = 2,
    trials: Annotated[int, typer.Option(min=1, help="Simulated candidates per resting pose.")] = 10,
    views: Annotated[int, typer.Option(min=1, help="Training views.")] = 20,
    dataset: Dataset = None,
) -> None:
    """Validated grasps per second and core, time per trial by stage, time per view."""
    from dgs_learning.cli.files import existing_dataset, put_out
    from dgs_learning.cli.machine import measured_here
    from dgs_learning.dataset import load_dataset
    from dgs_learning.synthesis import measure

    data = load_dataset(existing_dataset(dataset))
    measured = {
        **measured_here(),
        "setting": {"per_class": per_class, "trials": trials, "views": views, "seed": 0},
        "time": "processor time of one process",
        "stage1": measure.measure_grasps(per_class, trials),
        "views": measure.measure_views(data, views),
    }
    put_out("synthesis.txt", measured, json_file)
