"""`dgs bench-edges`: what a camera's depth does at edges, beside what the simulated one does."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgs_learning.cli.options import Dataset, Doc, Json


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

    from dgs_description.paths import revision, today
    from dgs_learning.cli.files import existing_dataset, put_out
    from dgs_learning.cli.refusal import refuse
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
    command = f"dgs bench-edges {'FRAMES ' if frames else ''}--focal {focal:g} --views {views}"
    result = {"command": command, "revision": revision(), "date": today(), "rows": rows}
    put_out("depth_edges.md", result, json_file, doc)
