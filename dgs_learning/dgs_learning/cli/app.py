"""The command `dgs`: objects, grasps, scenes, training and evaluation. Every subcommand imports only what it needs."""

from __future__ import annotations

import typer

from dgs_learning.cli.bench_inference import bench_inference
from dgs_learning.cli.bench_planning import bench_planning
from dgs_learning.cli.bench_synthesis import bench_synthesis
from dgs_learning.cli.bench_training import bench_training
from dgs_learning.cli.evaluate import evaluate
from dgs_learning.cli.evaluate_all import evaluate_all
from dgs_learning.cli.export import export
from dgs_learning.cli.generate import grasps, objects, scenes
from dgs_learning.cli.import_meshes import import_meshes
from dgs_learning.cli.inspect import inspect
from dgs_learning.cli.model_card import model_card
from dgs_learning.cli.plot_curve import plot_curve
from dgs_learning.cli.predict import predict
from dgs_learning.cli.report import report
from dgs_learning.cli.series import growth, loss_chain, robustness
from dgs_learning.cli.train import publish, train
from dgs_learning.cli.validate import validate

app = typer.Typer(
    no_args_is_help=True, add_completion=False, help="Offline tools of the dexterous grasping suite."
)


app.command("objects")(objects)
app.command("grasps")(grasps)
app.command("scenes")(scenes)
app.command("train")(train)
app.command("publish")(publish)
app.command("evaluate")(evaluate)
app.command("evaluate-all")(evaluate_all)
app.command("loss-chain")(loss_chain)
app.command("growth")(growth)
app.command("robustness")(robustness)
app.command("report")(report)
app.command("predict")(predict)
app.command("bench-synthesis")(bench_synthesis)
app.command("bench-planning")(bench_planning)
app.command("export")(export)
app.command("import")(import_meshes)
app.command("inspect")(inspect)
app.command("validate")(validate)
app.command("bench-inference")(bench_inference)
app.command("bench-training")(bench_training)
app.command("model-card")(model_card)
app.command("plot-curve")(plot_curve)
