"""`dgs bench-edges`, `-paths`, `-planning`, `-synthesis`, `-table`: how well and how fast parts of the suite work."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import typer

from dgs_description.paths import revision, today
from dgs_learning import paths
from dgs_learning.cli.files import existing_dataset, put_out
from dgs_learning.cli.machine import measured_here, processor
from dgs_learning.cli.options import Dataset, Doc, Json
from dgs_learning.cli.refusal import refusals, refuse

RECORDS = Path("runs/bench_planning")


def bench_edges(
    frames: Annotated[list[Path] | None, typer.Argument(help="16-bit depth images [mm] of a camera.")] = None,
    focal: Annotated[float, typer.Option(min=1.0, help="Its focal length [px].")] = 447.0,
    farthest: Annotated[float, typer.Option(help="What is farther away is left out [m].")] = 1.6,
    views: Annotated[int, typer.Option(min=1, help="Rendered views beside them.")] = 8,
    dataset: Dataset = None,
    json_file: Json = None,
    doc: Doc = None,
) -> None:
    """Measure curtains, gaps and wandering at the edges of real depth images and of rendered ones."""
    import numpy as np

    from dgs_learning.dataset import load_dataset
    from dgs_learning.evaluation.depth_edges import find_edges, rendered, summarise
    from dgs_learning.prediction.cloud_file import read_depth
    from dgs_sim_bridge.render.d455 import D455, D455Noise

    scenes = load_dataset(existing_dataset(dataset))
    rows = {}
    if frames:
        images = [1e-3 * read_depth(frame) for frame in frames]
        near = (np.where(image < farthest, image, 0.0) for image in images)
        edges = [find_edges(image, focal) for image in near]
        if not any(len(found.wander) for found in edges):
            refuse(
                f"no edges nearer than {farthest:g} m in {len(edges)} images: is it depth in mm, seen by rows?"
            )
        rows["these frames"] = summarise(edges)
    perfect = D455Noise(subpixel_rms=0, bias_rms=0, edge_jitter=0, smeared=0, dropped=0)
    for name, noise in (("rendered", D455Noise()), ("rendered, edges as they are", perfect)):
        made = (rendered(scenes, k, noise) for k in range(views))
        rows[name] = summarise(find_edges(image, D455.fx) for image in made)
    of_frames = f" FRAMES --focal {focal:g} --farthest {farthest:g}" if frames else ""
    command = f"dgs bench-edges{of_frames} --views {views}"
    result = {"command": command, "revision": revision(), "date": today(), "rows": rows}
    put_out("depth_edges.md", result, json_file, doc)


def bench_paths(
    folder: Annotated[
        Path, typer.Argument(help="ur5.urdf, ur5.srdf, meshes and problems/ of MotionBenchMaker.")
    ],
    count: Annotated[int, typer.Option(min=1, help="Problems of each kind of scene.")] = 100,
    timeout: Annotated[
        float, typer.Option(min=0.01, help="Processor time per problem and method [s].")
    ] = 5.0,
    json_file: Json = None,
    doc: Doc = None,
) -> None:
    """Solve the UR5 problems of MotionBenchMaker in a folder: share solved and time, path stage and RRT-Connect."""
    from tqdm import tqdm

    from dgs_learning.planning.path_problems import ProblemFolder, solve, summarise

    problems = ProblemFolder(folder)
    records = [
        solve(problem, timeout)
        for scene in tqdm(problems.scenes, desc="scenes", disable=None)
        for problem in problems.problems(scene, count)
    ]
    measured = {
        "command": f"dgs bench-paths FOLDER --count {count} --timeout {timeout:g}",
        "date": today(),
        "revision": revision(),
        "processor": processor(),
        "rows": summarise(records),
    }
    put_out("paths.md", measured, json_file, doc)


def bench_planning(
    scenes: Annotated[int, typer.Option(min=1, help="Random scenes of 4 to 6 novel objects.")] = 300,
    seed: Annotated[int, typer.Option(min=0, help="Of the scenes.")] = 0,
    json_file: Json = None,
    out: Annotated[
        Path, typer.Option(file_okay=False, help="One record per scene; a stopped run goes on.")
    ] = RECORDS,
    doc: Doc = None,
) -> None:
    """Plan one pick per scene; compare with exhaustive search and OMPL; drive every plan through PyBullet."""
    from dgs_learning.planning.measure import load_records, summarise

    with refusals(ValueError):
        _measure_missing(out, scenes, seed)
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


def _measure_missing(out: Path, scenes: int, seed: int) -> None:
    """Measure the scenes that have no record yet. Raises ValueError when the folder holds another setting's."""
    from tqdm import tqdm

    from dgs_grasp_planner.runtime import prepare_process

    prepare_process()
    import torch

    from dgs_grasp_planner.load import load_planner
    from dgs_grasp_planner.network.weights import read_info
    from dgs_grasp_planner.planner import GRASPING
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
        "proposers": list(GRASPING),
        "catalogue": describe_catalogue("novel", catalogue),
        "objects": [cases.FEWEST, cases.MOST],
        "most_candidates": cases.CANDIDATES,
        "min_score": cases.MIN_SCORE,
    }
    claim(out, setting)
    # Loaded where a scene has no record yet.
    planner = cache(lambda: load_planner(models, "dgs_net", proposers=GRASPING))
    numbers = tqdm(range(scenes), desc="scenes", disable=None)
    measure_missing(out / "scenes", numbers, lambda k: cases.make_case(k, seed, catalogue, planner()))


def bench_synthesis(
    json_file: Json = None,
    per_class: Annotated[int, typer.Option(min=1, help="Objects of every class.")] = 2,
    trials: Annotated[int, typer.Option(min=1, help="Simulated candidates per resting pose.")] = 10,
    views: Annotated[int, typer.Option(min=1, help="Training views.")] = 20,
    dataset: Dataset = None,
) -> None:
    """Validated grasps per second and core, time per trial by stage, time per view."""
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


def bench_table(
    views: Annotated[int, typer.Option(min=8, help="Rendered views; eight kinds take turns.")] = 400,
    seed: Annotated[int, typer.Option(min=0, help="Of the views.")] = 0,
    json_file: Json = None,
    doc: Doc = None,
) -> None:
    """Find the table in rendered views with the camera's noise: 0.3 to 1.5 m away, tilted by 0 to 70 degrees."""
    from tqdm import tqdm

    from dgs_learning.evaluation.table_poses import draw_view, find, summarise
    from dgs_sim_bridge.render.object_model import find_catalogue

    catalogue = find_catalogue("novel")
    numbers = tqdm(range(views), desc="views", disable=None)
    summary = summarise(find(draw_view(catalogue, seed, k)) for k in numbers)
    command = f"dgs bench-table --views {views} --seed {seed}"
    result = {"command": command, "revision": revision(), "date": today(), "views": summary}
    put_out("table_poses.md", result, json_file, doc)
