"""`dgs evaluate-all`: the whole evaluation, run after run into one folder, and one report of all runs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from dgs_learning.cli.evaluate import evaluate

TEN, FEW = ("10", (0.6, 0.6)), ("4-6", (0.4, 0.8))
"""Objects per scene and workspace [m] of the paper's two settings."""


@dataclass(frozen=True)
class Experiment:
    """One run: planner, ablation, objects per scene and workspace."""

    planner: str
    ablate: str
    scene: tuple[str, tuple[float, float]]
    objects: str = "novel"

    @property
    def folder(self) -> str:
        """Name of its run folder."""
        ablate = "" if self.ablate == "none" else f"_without_{self.ablate}"
        return f"{self.planner}{ablate}_{self.objects}_{self.scene[0]}"


EXPERIMENTS = (
    Experiment("dgs_net", "none", FEW),
    Experiment("top_down", "none", FEW),
    Experiment("dgs_net", "none", TEN),
    Experiment("dgs_net", "pre_grasp", TEN),
    Experiment("dgs_net", "offset", TEN),
    Experiment("top_down", "none", TEN),
    Experiment("random_prior", "none", TEN),
    Experiment("replay", "none", FEW, "dataset"),
)
"""Tables II to IV, the baselines, and the harness against itself."""
ROBOT_FOLDER = "robot"
"""Of the run that fills Table V."""


def evaluate_all(
    out: Annotated[Path, typer.Option(help="Folder of all runs; unfinished ones in it go on.")] = Path(
        "runs/evaluation"
    ),
    scenes: Annotated[int, typer.Option(help="Scenes per run (paper: 240).")] = 60,
    seed: Annotated[int, typer.Option(help="The same seed gives the same tables.")] = 0,
    workers: Annotated[int, typer.Option(help="Processes; 0 = one per core.")] = 0,
    robot_scenes: Annotated[
        int, typer.Option(min=0, help="Scenes of the robot protocol (paper: 25); 0 = leave it out.")
    ] = 25,
    publish: Annotated[
        bool, typer.Option("--publish", help="Copy the summaries to docs/results and fill the README.")
    ] = False,
) -> None:
    """Every table of the paper that a simulation can fill: hours, resumable, ends with one report of all runs."""
    from dgs_learning.cli.report import report

    for experiment in EXPERIMENTS:
        typer.echo(f"== {experiment.folder}")
        evaluate(
            out=out / experiment.folder,
            objects=experiment.objects,
            scenes=scenes,
            objects_per_scene=experiment.scene[0],
            workspace=experiment.scene[1],
            seed=seed,
            planner=experiment.planner,
            ablate=experiment.ablate,
            workers=workers,
        )
    runs = [out / experiment.folder for experiment in EXPERIMENTS]
    if robot_scenes:
        typer.echo(f"== {ROBOT_FOLDER}")
        evaluate(out=out / ROBOT_FOLDER, scenes=robot_scenes, seed=seed, arm=True)
        runs.append(out / ROBOT_FOLDER)
    report(runs, out=out / "report.html", gallery=24, publish=publish, readme=publish)
