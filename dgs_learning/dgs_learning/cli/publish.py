"""`dgs publish`: weights of a training to the models directory, and the model card beside them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from dgs_learning import paths
from dgs_learning.cli.options import Dataset


def publish(
    run: Annotated[Path | None, typer.Argument(help="Training folder; without it only the card.")] = None,
    name: Annotated[str, typer.Option(help="Name of the shipped weights.")] = "dgs_net",
    models_dir: Annotated[Path | None, typer.Option(help="Where weights and card lie.")] = None,
    dataset: Dataset = None,
    results: Annotated[
        Path | None,
        typer.Option(
            help="Folder of results of experiments; else docs/results, and in it the folder of another hand."
        ),
    ] = None,
    keep: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Share of the weights there that is kept: both are averaged."),
    ] = 0.0,
) -> None:
    """Copy the averaged weights and the curves of a training to the models directory; write the model card there.

    Of weights that a training went on from a share may be kept: the mean of both (Wortsman et al., Robust fine-tuning
    of zero-shot models, CVPR 2022).

    The card has data, configuration, deviations from the paper, curves, metrics, speed and limits.
    """
    from dgs_description.hand import DEFAULT, HAND
    from dgs_grasp_planner.network import load_network, save_network
    from dgs_grasp_planner.network.weights import mean_of
    from dgs_learning.cli.refusal import refuse
    from dgs_learning.evaluation.report.model_card import curve_file, write_card

    directory = models_dir or paths.weights_dir()
    if run is not None:
        net, info = load_network(run, "latest")
        notes = info.notes
        if keep:
            earlier, before = load_network(directory, name)
            if before.notes.get("kept", {}).get("with") == info.sha256:
                refuse(f"{name} is a mean with these weights already: `dgs publish` alone writes the card")
            net = mean_of(net, earlier, keep)
            notes = notes | {
                "kept": {
                    "share": keep,
                    "sha256": before.sha256,
                    "step": before.notes.get("step"),
                    "with": info.sha256,
                }
            }
        shipped = save_network(net, directory, name, notes)
        about = f"step {info.notes.get('step')}, SHA-256 {shipped.sha256[:16]}..."
        typer.echo(f"{name}: {about} -> {directory}")
        curve = curve_file(directory, name)
        for stale in (curve, curve.with_suffix(".png")):  # of other weights
            stale.unlink(missing_ok=True)
        if (run / "curve.csv").is_file():
            shutil.copyfile(run / "curve.csv", curve)
    of_default, own = paths.repository() / "docs" / "results", HAND.name != DEFAULT
    published = results or (of_default / HAND.name if own else of_default)
    card = write_card(directory, name, dataset or paths.dataset_file(), published)
    typer.echo(f"model card: {card}")
