"""`dgs bench-table`: how often and how well the table is found, over camera poses and surroundings."""

from __future__ import annotations

from typing import Annotated

import typer

from dgs_learning.cli.options import Doc, Json


def bench_table(
    views: Annotated[int, typer.Option(min=8, help="Rendered views; eight kinds take turns.")] = 400,
    seed: Annotated[int, typer.Option(min=0, help="Of the views.")] = 0,
    json_file: Json = None,
    doc: Doc = None,
) -> None:
    """Find the table in rendered views with the camera's noise: 0.3 to 1.5 m away, tilted by 0 to 70 degrees."""
    from tqdm import tqdm

    from dgs_description.paths import revision, today
    from dgs_learning.cli.files import put_out
    from dgs_learning.evaluation.table_poses import draw_view, find, summarise
    from dgs_sim_bridge.render.object_model import find_catalogue

    catalogue = find_catalogue("novel")
    numbers = tqdm(range(views), desc="views", disable=None)
    summary = summarise(find(draw_view(catalogue, seed, k)) for k in numbers)
    command = f"dgs bench-table --views {views} --seed {seed}"
    result = {"command": command, "revision": revision(), "date": today(), "views": summary}
    put_out("table_poses.md", result, json_file, doc)
