"""`dgs loss-chain`, `dgs robustness`, `dgs growth`: series of evaluations that say where success is lost and won."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dgs_learning import paths
from dgs_learning.cli.evaluate import catalogue_of, number_range, one_thread_each

if TYPE_CHECKING:
    from dgs_learning.evaluation.protocol import Setting
    from dgs_learning.evaluation.series import Row

Scenes = Annotated[int, typer.Option(min=1, help="Scenes per run; more may be added later.")]
Objects = Annotated[str, typer.Option(help="As in `dgs evaluate`.")]
PerScene = Annotated[str, typer.Option(help="A number or a range such as 4-6.")]
Workspace = Annotated[tuple[float, float], typer.Option(help="Extent in x and y [m].")]
Seed = Annotated[int, typer.Option(help="The same scenes for every run of the series.")]
Only = Annotated[list[str] | None, typer.Option(help="These runs only; may be given several times.")]
Publish = Annotated[
    bool, typer.Option("--publish", help="Write docs/results and the table in docs/evaluation.md.")
]


def loss_chain(
    out: Annotated[Path, typer.Option(help="Folder of the runs; unfinished ones in it go on.")] = Path(
        "runs/loss_chain"
    ),
    objects: Objects = "dataset",
    scenes: Scenes = 20,
    objects_per_scene: PerScene = "4-6",
    workspace: Workspace = (0.4, 0.8),
    seed: Seed = 100,
    only: Only = None,
    model: Annotated[str, typer.Option(help="Name of the weights.")] = "dgs_net",
    models_dir: Annotated[Path | None, typer.Option(help="Where the weights lie.")] = None,
    dataset: Annotated[
        Path | None, typer.Option(help="Dataset file with the grasps that are replayed.")
    ] = None,
    workers: Annotated[int, typer.Option(help="Processes; 0 = one per core.")] = 0,
    publish: Publish = False,
) -> None:
    """From replayed grasps to the whole planner: the success rate with one answer of the network after another."""
    one_thread_each()
    from dgs_learning.evaluation.loss_chain import CHAIN
    from dgs_learning.evaluation.proposers import PlannerChoice
    from dgs_learning.evaluation.run import run_experiment
    from dgs_learning.evaluation.series import Row
    from dgs_learning.parallel import process_count

    def run(setting: Setting) -> list[Row]:
        name, catalogue = catalogue_of(objects, dataset)
        names, rows = chosen([step.name for step in CHAIN], only), []
        for link in (step for step in CHAIN if step.name in names):
            typer.echo(f"== {link.name}: {link.text}")
            choice = PlannerChoice(link.planner, model, models_dir, dataset, link.without)
            folder = out / link.name
            summary = run_experiment(catalogue, name, choice, setting, folder, process_count(workers))
            rows.append(Row(link.name, link.text, summary))
        return rows

    _series("loss_chain", run, (scenes, objects_per_scene, workspace, seed), publish)


def robustness(
    out: Annotated[Path, typer.Option(help="Folder of the runs; unfinished ones in it go on.")] = Path(
        "runs/robustness"
    ),
    objects: Objects = "novel",
    scenes: Scenes = 10,
    objects_per_scene: PerScene = "4-6",
    workspace: Workspace = (0.4, 0.8),
    seed: Seed = 200,
    only: Only = None,
    meshes: Annotated[
        Path | None, typer.Option(help="One more run with the objects of this folder in the import format.")
    ] = None,
    planner: Annotated[str, typer.Option(help="As in `dgs evaluate`.")] = "dgs_net",
    model: Annotated[str, typer.Option(help="Name of the weights.")] = "dgs_net",
    models_dir: Annotated[Path | None, typer.Option(help="Where the weights lie.")] = None,
    publish: Publish = False,
) -> None:
    """The success rate under disturbed clouds, other views and other objects, on the same scenes."""
    one_thread_each()
    from dgs_learning.evaluation.proposers import PlannerChoice
    from dgs_learning.evaluation.robustness import CONDITIONS, Condition, run_condition
    from dgs_learning.evaluation.series import Row

    def run(setting: Setting) -> list[Row]:
        choice = PlannerChoice(planner, model, models_dir)
        rows = []
        wanted = [c for c in CONDITIONS if c.name in chosen([c.name for c in CONDITIONS], only)]
        runs = [(condition, objects) for condition in wanted]
        if meshes is not None:
            runs.append((Condition("meshes", f"objects of `{meshes.name}`"), str(meshes)))
        for condition, which in runs:
            typer.echo(f"== {condition.name}: {condition.text}")
            name, catalogue = catalogue_of(which, None)
            summary = run_condition(condition, catalogue, name, choice, setting, out / condition.name)
            rows.append(Row(condition.name, condition.text, summary))
        return rows

    _series("robustness", run, (scenes, objects_per_scene, workspace, seed), publish)


def growth(
    weights: Annotated[
        list[Path], typer.Argument(help="Files of weights, folder/name; also those that others began from.")
    ],
    out: Annotated[Path, typer.Option(help="Folder of the runs; unfinished ones in it go on.")] = Path(
        "runs/growth"
    ),
    objects: Objects = "novel",
    scenes: Scenes = 15,
    objects_per_scene: PerScene = "4-6",
    workspace: Workspace = (0.4, 0.8),
    seed: Seed = 300,
    only: Annotated[
        list[str] | None,
        typer.Option(help="predicted = the network alone, or proposed = within the planner."),
    ] = None,
    dataset: Annotated[Path | None, typer.Option(help="The present dataset file.")] = None,
    workers: Annotated[int, typer.Option(help="Processes; 0 = one per core.")] = 0,
    publish: Publish = False,
) -> None:
    """The success rate of several weights, alone and within the planner, by what they were trained on."""
    one_thread_each()
    from dgs_learning.evaluation.growth import ALONE, MEASURED, seen
    from dgs_learning.evaluation.proposers import PlannerChoice
    from dgs_learning.evaluation.run import run_experiment
    from dgs_learning.evaluation.series import Row
    from dgs_learning.parallel import process_count

    def run(setting: Setting) -> list[Row]:
        name, catalogue = catalogue_of(objects, None)
        present = dataset or paths.dataset_file()
        known = sorted(
            (seen(file, present, weights) for file in weights),
            key=lambda s: (s.another_dataset, s.scenes, s.views),
        )
        names = chosen([step.name for step in MEASURED], only)
        rows = []
        for step in (step for step in MEASURED if step.name in names):
            for one in known:
                text = f"{one.text}, {'alone' if step.name == ALONE else 'in the planner'}"
                typer.echo(f"== {text}")
                choice = PlannerChoice(step.planner, one.model, one.folder, None, step.without)
                folder = out / f"{one.folder.name}_{one.model}_{step.name}"
                summary = run_experiment(catalogue, name, choice, setting, folder, process_count(workers))
                rows.append(Row(folder.name, text, summary))
        return rows

    _series("growth", run, (scenes, objects_per_scene, workspace, seed), publish)


def chosen(names: Sequence[str], only: Sequence[str] | None) -> list[str]:
    """The names that were asked for, all of them where none was.

    Raises:
        ValueError: there is no such run.
    """
    for name in only or ():
        if name not in names:
            raise ValueError(f"no run named {name!r}; there are {', '.join(names)}")
    return [name for name in names if not only or name in only]


def _series(
    name: str,
    run: Callable[[Setting], list[Row]],
    values: tuple[int, str, tuple[float, float], int],
    publish: bool,
) -> None:
    from dgs_description.documents import fill_block
    from dgs_learning.cli.refusal import refusals
    from dgs_learning.evaluation.protocol import Setting
    from dgs_learning.evaluation.series import series_note, series_table, write_series

    scenes, objects_per_scene, workspace, seed = values
    try:
        with refusals():
            rows = run(Setting(scenes, number_range(objects_per_scene), workspace, seed))
    except (ValueError, FileNotFoundError) as error:
        raise typer.BadParameter(str(error)) from None
    text = f"{series_table(rows)}\n\n{series_note(rows)}"
    typer.echo(text)
    if publish:
        docs = paths.repository() / "docs"
        write_series(docs / "results" / f"{name}.json", rows)
        fill_block(docs / "evaluation.md", name.replace("_", "-"), text)
