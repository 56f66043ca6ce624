"""`dgs bench-planning`: planning time and success of the arm's pick planner, beside OMPL, checked in PyBullet."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from dgs_learning import paths
from dgs_learning.cli.options import Doc, Json

RECORDS = Path("runs/bench_planning")


def bench_planning(
    scenes: Annotated[int, typer.Option(min=1, help="Random scenes of 4 to 6 novel objects.")] = 300,
    seed: Annotated[int, typer.Option(min=0, help="Of the scenes.")] = 0,
    json_file: Json = None,
    out: Annotated[Path, typer.Option(help="One record per scene; a stopped run goes on.")] = RECORDS,
    minutes: Annotated[float, typer.Option(min=0, help="Begin no scene after these; 0 = no limit.")] = 0.0,
    doc: Doc = None,
) -> None:
    """Plan one pick per scene; compare with exhaustive search and OMPL; drive every plan through PyBullet."""
    from dgs_learning.cli.files import put_out
    from dgs_learning.cli.machine import measured_here
    from dgs_learning.cli.refusal import refusals
    from dgs_learning.planning.measure import load_records, summarise

    with refusals(ValueError):
        _measure_missing(out, scenes, seed, minutes)
    records = load_records(out / "scenes")[:scenes]
    here, kept = measured_here(), ("processor", "cores", "python", "system", "load_average")
    measured: dict[str, Any] = {
        "command": f"dgs bench-planning --scenes {scenes} --seed {seed}",
        "date": here["date"],
        "machine": {key: here["machine"][key] for key in kept},
        "setting": json.loads((out / "setting.json").read_text()) | {"scenes_wanted": scenes, "threads": 1},
        **summarise(records),
    }
    put_out("planning.md", measured, json_file, doc)


def _measure_missing(out: Path, scenes: int, seed: int, minutes: float) -> None:
    """Measure the scenes that have no record yet. Raises ValueError when the folder holds another setting's."""
    from tqdm import tqdm

    from dgs_grasp_planner.runtime import prepare_process

    prepare_process()
    import torch

    from dgs_grasp_planner.cell_planner import CellPlanner
    from dgs_grasp_planner.load import load_planner
    from dgs_grasp_planner.network.weights import read_info
    from dgs_learning.evaluation.provenance import describe_catalogue
    from dgs_learning.evaluation.records import claim
    from dgs_learning.planning import cases
    from dgs_learning.planning.measure import measure_missing
    from dgs_sim_bridge.render.object_model import find_catalogue

    torch.set_num_threads(1)
    models, catalogue = paths.weights_dir(), find_catalogue("novel")
    setting = {
        "seed": seed,
        "model_sha256": read_info(models, "dgs_net").sha256[:16],
        "catalogue": describe_catalogue("novel", catalogue),
        "objects": [cases.FEWEST, cases.MOST],
        "most_candidates": cases.CANDIDATES,
        "min_score": cases.MIN_SCORE,
    }
    claim(out, setting)
    planner = CellPlanner(lambda: load_planner(models, "dgs_net"))
    numbers = tqdm(range(scenes), desc="scenes", disable=None)
    measure_missing(out / "scenes", numbers, lambda k: cases.make_case(k, seed, catalogue, planner), minutes)
