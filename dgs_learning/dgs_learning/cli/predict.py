"""`dgs predict`: grasps for a cloud or a depth image in a file, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from dgs_description.words import plural
from dgs_learning import paths
from dgs_learning.cli.options import Device, Json, Model, ModelsDir, Threads
from dgs_learning.cli.refusal import refuse

NO_GRASP_EXIT = 1


def predict(
    source: Annotated[Path, typer.Argument(metavar="INPUT", help="A cloud [m] or a 16-bit depth PNG [mm].")],
    json_file: Json = None,
    picture: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Write a PNG of cloud and hands here.")
    ] = None,
    intrinsics: Annotated[str | None, typer.Option(help="Of a depth image: fx,fy,cx,cy or a file.")] = None,
    in_cell: Annotated[
        bool,
        typer.Option(
            "--in-cell", help="The camera stands as in the cell ($DGS_CELL); else the table is found."
        ),
    ] = False,
    mask: Annotated[
        Path | None,
        typer.Option(help="Image, not black where something may be grasped; else all on the table."),
    ] = None,
    edge_filter: Annotated[
        bool, typer.Option("--edge-filter/--raw", help="Set flying pixels of a depth image right.")
    ] = True,
    cloud_frame: Annotated[Literal["camera", "base_link"], typer.Option(help="Of the cloud.")] = "camera",
    model: Model = "dgs_net",
    models_dir: ModelsDir = None,
    max_grasps: Annotated[int, typer.Option(min=1, max=256)] = 32,
    min_score: Annotated[float | None, typer.Option(min=0.0, max=1.0)] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same answer.")] = 0,
    device: Device = "cpu",
    threads: Threads = 0,
) -> None:
    """Predict grasps for one cloud. Exit code 0; 1 = no grasp found; 2 = bad input."""
    from dgs_grasp_planner.runtime import prepare_process

    if picture is not None and picture.suffix.lower() != ".png":
        refuse(f"{picture} is no name of a PNG")
    if cloud_frame == "base_link" and source.suffix.lower() == ".png":
        refuse("a depth image is in the camera's frame: --cloud-frame base_link is for clouds")
    prepare_process()
    import torch

    from dgs_description.cell import CELL
    from dgs_description.frames import apply
    from dgs_grasp_planner.load import load_planner
    from dgs_grasp_planner.network.weights import read_info
    from dgs_grasp_planner.planner import GRASPING
    from dgs_grasp_planner.scene import PlanRequest
    from dgs_learning.prediction.answer import write_answer
    from dgs_learning.prediction.cloud_file import read_cloud
    from dgs_learning.prediction.offline import answer_in_cell, answer_on_estimated_table

    cloud = read_cloud(source, intrinsics, mask, edge_filter)
    if threads:
        torch.set_num_threads(threads)
    weights = models_dir or paths.weights_dir()
    planner = load_planner(weights, model, device, proposers=GRASPING)
    request = PlanRequest(max_grasps=max_grasps, min_score=min_score)
    if cloud_frame == "base_link" or in_cell:
        in_base, T_base_camera = cloud_frame == "base_link", CELL.T_base_camera_optical
        points = cloud.points if in_base else apply(T_base_camera, cloud.points.astype(float))
        answer = answer_in_cell(planner, points, T_base_camera, seed, request, cloud.masked)
    else:
        answer = answer_on_estimated_table(planner, cloud.points, seed, request, cloud.masked)
    info = read_info(weights, model)
    about = {"id": info.model_id, "sha256": info.sha256}
    extra = {"input": {"file": source.name, "points": cloud.received}, "model": about, "seed": seed}
    colours = None if cloud.colours is None else cloud.colours[answer.rows]
    write_answer(answer, extra, colours, json_file, picture)
    if answer.error is not None:
        typer.echo(
            f"error {answer.error.code.value} {answer.error.code.name}: {answer.error.message}", err=True
        )
        raise typer.Exit(NO_GRASP_EXIT)
    grasps, seconds = answer.prediction.grasps, answer.prediction.stage_times["total"]
    count = plural(len(grasps), "grasp")
    typer.echo(f"{count} in {answer.frame}, best score {grasps.score[0]:.3f}, {seconds:.2f} s")
