"""The command `dgs`: objects, grasps, scenes, training and evaluation. Every subcommand imports only what it needs."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

from dgs_learning.cli.bench import bench_edges, bench_paths, bench_planning, bench_synthesis, bench_table
from dgs_learning.cli.bench_inference import bench_inference
from dgs_learning.cli.bench_training import bench_training
from dgs_learning.cli.evaluate import evaluate
from dgs_learning.cli.experiment import exam, experiment
from dgs_learning.cli.export import export
from dgs_learning.cli.generate import grasps, objects, scenes
from dgs_learning.cli.import_meshes import import_meshes
from dgs_learning.cli.inspect import inspect
from dgs_learning.cli.predict import predict
from dgs_learning.cli.publish import publish
from dgs_learning.cli.refusal import refusals
from dgs_learning.cli.report import plot_curve, report
from dgs_learning.cli.success import fit_success, trials
from dgs_learning.cli.train_unets import train_completion, train_shape_completion
from dgs_learning.cli.validate import validate


class Dgs(TyperGroup):
    """All subcommands; what one of them refuses ends with a code and a sentence, without a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the subcommand that is named; a file that cannot be written, too, is named without a traceback."""
        with refusals(OSError):
            return super().invoke(ctx)


app = typer.Typer(
    cls=Dgs,
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,  # it would take the units, in brackets, for markup
    help="Offline tools of the dexterous grasping suite.",
)

for command in (
    objects, grasps, scenes, inspect, validate, export, publish, plot_curve, evaluate, exam, experiment,
    report, predict, trials, fit_success, train_completion, train_shape_completion, bench_edges, bench_inference,
    bench_paths, bench_planning, bench_synthesis, bench_table, bench_training,
):  # fmt: skip
    app.command()(command)
app.command("import")(import_meshes)


@app.command(
    add_help_option=False, context_settings={"allow_extra_args": True, "ignore_unknown_options": True}
)
def train(context: typer.Context) -> None:
    """Train DGS-Net; goes on from the checkpoint in the output folder if there is one."""
    from dgs_learning.training.__main__ import main

    raise typer.Exit(main(context.args, "dgs train"))
