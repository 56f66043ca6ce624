"""The command `dgs`: objects, grasps, scenes, training and evaluation. Every subcommand imports only what it needs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dgs_learning import paths
from dgs_learning.commands.bench_inference import bench_inference
from dgs_learning.commands.bench_planning import bench_planning
from dgs_learning.commands.bench_synthesis import bench_synthesis
from dgs_learning.commands.bench_training import bench_training
from dgs_learning.commands.evaluate import evaluate
from dgs_learning.commands.evaluate_all import evaluate_all
from dgs_learning.commands.export import export
from dgs_learning.commands.import_meshes import import_meshes
from dgs_learning.commands.inspect import inspect
from dgs_learning.commands.model_card import model_card
from dgs_learning.commands.plot_curve import plot_curve
from dgs_learning.commands.predict import predict
from dgs_learning.commands.refusal import refusals
from dgs_learning.commands.report import report
from dgs_learning.commands.series import growth, loss_chain, robustness
from dgs_learning.commands.validate import validate

app = typer.Typer(
    no_args_is_help=True, add_completion=False, help="Offline tools of the dexterous grasping suite."
)

Workers = Annotated[int, typer.Option(help="Processes; 0 = one per core.")]
Seed = Annotated[int, typer.Option(help="The same seed gives the same result on any number of workers.")]
Backend = Annotated[str, typer.Option(help="loky (processes here), dask or ray.")]
Cluster = Annotated[str, typer.Option(help="Address of a running dask scheduler or ray head.")]


@app.command()
def objects(
    seed: Seed = 1, out: Annotated[Path | None, typer.Option(help="Catalogue file to write.")] = None
) -> None:
    """Write the catalogue of novel test objects."""
    from dgs_learning.objects.catalogue import novel_catalogue
    from dgs_sim_bridge.render.object_model import save_catalogue

    target = out or paths.novel_file()
    models = novel_catalogue(seed)
    save_catalogue(target, models)
    typer.echo(f"{len(models)} novel objects -> {target}")


@app.command()
def grasps(
    seed: Seed = 0,
    target: Annotated[int, typer.Option(help="Grasps per object and scale after which it is done.")] = 24,
    max_chunks: Annotated[int, typer.Option(help="Chunks of draws after which it is done all the same.")] = 5,
    per_pose: Annotated[int, typer.Option(min=1, help="Grasps per resting pose at least.")] = 4,
    scales: Annotated[int, typer.Option(min=1, max=5, help="Scales per object, taken in turn.")] = 1,
    known: Annotated[Path | None, typer.Option(help="Dataset file whose object-scales are kept.")] = None,
    workers: Workers = 0,
    backend: Backend = "loky",
    cluster: Cluster = "",
) -> None:
    """Stage 1: validated grasps of single objects. Resumable: what is done is skipped, down to the chunk."""
    from dgs_learning.dataset import load_dataset
    from dgs_learning.parallel import Engine, process_count
    from dgs_learning.synthesis.generate import generate_grasps, restore, work_list
    from dgs_learning.synthesis.stage_one import Effort

    engine = Engine(process_count(workers), backend, cluster)
    models, folder = work_list(seed, scales), paths.data_dir() / "stage1"
    if known is not None:
        kept = restore(load_dataset(known), [model for model, _ in models], folder)
        typer.echo(f"{kept} object-scales kept from {known}")
    made = generate_grasps(models, folder, Effort(target, max_chunks, per_pose), engine)
    typer.echo(f"{made} grasps made")


@app.command()
def scenes(
    seed: Seed = 0,
    count: Annotated[int, typer.Option(help="Number of scenes.")] = 240,
    workers: Workers = 0,
    backend: Backend = "loky",
    cluster: Cluster = "",
    out: Annotated[Path | None, typer.Option(help="Dataset file to write.")] = None,
) -> None:
    """Stage 2: settled scenes with their feasible grasps, packed with stage 1 into the dataset file. Resumable."""
    from dgs_learning.dataset import save_dataset
    from dgs_learning.parallel import Engine, process_count
    from dgs_learning.synthesis.generate import collect, generate_scenes, work_list

    models = [model for model, _ in work_list(0, 5)]
    grasps = collect(models, paths.data_dir() / "stage1")
    engine = Engine(process_count(workers), backend, cluster)
    dataset = generate_scenes(grasps, count, seed, engine, paths.data_dir() / "stage2")
    target = out or paths.dataset_file()
    save_dataset(target, dataset)
    total = sum(len(scene.instance) for scene in dataset.scenes)
    typer.echo(
        f"{len(dataset.objects)} objects, {len(dataset.position)} grasps, {len(dataset.scenes)} scenes, "
        f"{total} scene grasps -> {target} ({target.stat().st_size / 1e6:.1f} MB)"
    )


@app.command()
def train(
    preset: Annotated[str, typer.Option(help="Network configuration: fast or paper.")] = "fast",
    epochs: Annotated[float, typer.Option(help="Passes over all scenes and viewpoints.")] = 40.0,
    steps: Annotated[int, typer.Option(help="Updates in all; 0 = as the epochs say.")] = 0,
    batch: int = 10,
    learning_rate: float = 1e-3,
    views: Annotated[int, typer.Option(help="Viewpoints per scene.")] = 256,
    seed: Seed = 0,
    workers: Annotated[int, typer.Option(help="Processes that prepare views.")] = 1,
    threads: Annotated[int, typer.Option(help="Torch threads; 0 = torch's default.")] = 0,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    precision: Annotated[str, typer.Option(help="fp32, bf16, or auto = bf16 on a GPU.")] = "auto",
    held_out: Annotated[int, typer.Option(help="Scenes that are only measured on.")] = 4,
    scenes: Annotated[int, typer.Option(help="Scenes that are trained on; 0 = all others.")] = 0,
    validate_every: Annotated[
        int, typer.Option(help="Steps between two such measurements; 0 = never.")
    ] = 200,
    dataset: Annotated[Path | None, typer.Option(help="Dataset file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder of checkpoints and curves.")] = None,
    cache: Annotated[Path | None, typer.Option(help="Keep rendered views here.")] = None,
    init: Annotated[
        str, typer.Option(help="Weights to start from: a name in the models directory, or folder/name.")
    ] = "",
) -> None:
    """Train DGS-Net; goes on from the checkpoint in the output folder if there is one."""
    from dgs_grasp_planner.runtime import prepare_process

    prepare_process()
    from dgs_learning.training.settings import TrainingSettings
    from dgs_learning.training.start import TrainingFiles, start_training

    start = None if not init else Path(init) if "/" in init else paths.models_dir() / init
    target = out or paths.data_dir() / f"train_{preset}"
    files = TrainingFiles(dataset or paths.dataset_file(), target, cache, start)
    with refusals():
        settings = TrainingSettings(
            epochs=epochs, steps=steps, batch=batch, learning_rate=learning_rate, views_per_scene=views, seed=seed,
            workers=workers, threads=threads, device=device, precision=precision, held_out_scenes=held_out,
            training_scenes=scenes, validate_every=validate_every,
        )  # fmt: skip
        start_training(preset, files, settings)


@app.command()
def publish(
    run: Annotated[Path, typer.Argument(help="Training folder.")],
    name: Annotated[str, typer.Option(help="Name of the shipped weights.")] = "dgs_net",
) -> None:
    """Copy the averaged weights of a training run to the models directory, with their checksum."""
    from dgs_grasp_planner.network import load_network, save_network

    net, info = load_network(run, "latest")
    shipped = save_network(net, paths.models_dir(), name, info.notes)
    typer.echo(
        f"{name}: step {info.notes.get('step')}, SHA-256 {shipped.sha256[:16]}... -> {paths.models_dir()}"
    )


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


def main() -> None:
    """Entry point of `dgs`."""
    app()


if __name__ == "__main__":
    main()
