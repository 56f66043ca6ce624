"""`dgs bench-paths`: the arm's path stage on other people's problems, beside RRT-Connect as OMPL sets it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgs_learning.cli.options import Doc, Json


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

    from dgs_learning.cli.files import put_out
    from dgs_learning.cli.machine import measured_here
    from dgs_learning.planning.path_problems import ProblemFolder, solve, summarise

    problems = ProblemFolder(folder)
    records = [
        solve(problem, timeout)
        for scene in tqdm(problems.scenes, desc="scenes", disable=None)
        for problem in problems.problems(scene, count)
    ]
    here = measured_here()
    measured = {
        "command": f"dgs bench-paths FOLDER --count {count} --timeout {timeout:g}",
        "date": here["date"],
        "revision": here["revision"],
        "processor": here["machine"]["processor"],
        "rows": summarise(records),
    }
    put_out("paths.md", measured, json_file, doc)
