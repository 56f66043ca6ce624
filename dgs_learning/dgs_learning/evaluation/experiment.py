"""An experiment is data: a YAML file whose rows are runs of the clearing protocol, read into validated dataclasses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import yaml

from dgs_description.cell import CELL
from dgs_description.yaml_text import load_yaml
from dgs_grasp_planner.planner import SHIPPED, STAGES, PlannerSettings
from dgs_grasp_planner.propose.drag import Drag
from dgs_grasp_planner.propose.edge_pinch import EdgePinch
from dgs_grasp_planner.propose.push import Push
from dgs_learning import paths
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.protocol import EDGE, Setting
from dgs_sim_bridge.world.engines import ENGINES

FOLDER = Path(__file__).parent / "experiments"
PROPOSERS = (*SHIPPED, "top_down", "random_prior", "true_point", "true_rest", "replay")
"""docs/evaluation.md says what each is."""
WITH_NETWORK = ("dgs_net", "true_point", "true_rest")
ABLATIONS = ("none", "pre_grasp", "offset")
T = TypeVar("T")


@dataclass(frozen=True)
class Row:
    """One run, and one row of the table.

    Attributes:
        name: of its folder; text: of its row, empty = proposers and stages.
        proposers: whose grasps are tried, of `PROPOSERS`; without: stages that are left out, of `STAGES`.
        ablate: what is taken away from every proposal, as in Table II: "pre_grasp" (fixed open hand) or "offset".
        weights: name of the network's weights in the models directory, or FOLDER/NAME.
        dataset: dataset file of the proposers that use stored grasps; empty = the shipped one.
        objects: "novel", "household", "train", "everyday", "dataset" (of that file), a folder in the import
            format, or a catalogue; `@train` or `@held_out` behind it takes that part of it (see `load_part`).
        objects_per_scene: smallest and largest number; workspace: extent in x and y [m].
        scenes: number of scenes; seed: the same seed gives the same scenes in every row.
        engine: physics engine, one of `engines.ENGINES`.
        condition: how views and hardware differ from those of the training.
        arm: cleared by the whole ROS suite instead of a free hand; speed_up: simulated seconds per second then;
            overlap: the next pick is prepared while the arm carries; rehearse: without ROS, in one process.

    Raises:
        ValueError: no such run can be made.
    """

    name: str
    text: str = ""
    proposers: tuple[str, ...] = SHIPPED
    without: tuple[str, ...] = ()
    ablate: str = "none"
    weights: str = "dgs_net"
    dataset: str = ""
    objects: str = "novel"
    objects_per_scene: tuple[int, int] = (4, 6)
    workspace: tuple[float, float] = CELL.workspace_size
    scenes: int = 60
    seed: int = 0
    engine: str = "pybullet"
    condition: Condition = Condition()
    arm: bool = False
    speed_up: float = 1.0
    overlap: bool = True
    rehearse: bool = False

    def __post_init__(self) -> None:
        for name in self.proposers:
            if name not in PROPOSERS:
                raise ValueError(f"no proposer named {name!r}; there are {', '.join(PROPOSERS)}")
        if not self.proposers:
            raise ValueError("no proposer is named")
        if self.ablate not in ABLATIONS:
            raise ValueError(f"no ablation named {self.ablate!r}; there are {', '.join(ABLATIONS)}")
        _ = PlannerSettings(without=self.without), self.setting  # they refuse what they cannot do
        if self.rehearse and not self.arm:
            raise ValueError("only the robot is rehearsed: --rehearse goes with --arm")
        if self.engine not in ENGINES:
            raise ValueError(f"there is no engine {self.engine!r}, only {' and '.join(ENGINES)}")

    @property
    def models_dir(self) -> Path:
        """Where the weights lie."""
        return Path(self.weights).parent if "/" in self.weights else paths.weights_dir()

    @property
    def model(self) -> str:
        """Name of the weights in there."""
        return Path(self.weights).name.removesuffix(".pt")

    @property
    def dataset_file(self) -> Path:
        """Of the proposers that use stored grasps."""
        return Path(self.dataset) if self.dataset else paths.dataset_file()

    @property
    def setting(self) -> Setting:
        """The scenes; the table has an edge where a proposer needs one."""
        at_edge = set(self.proposers) & {EdgePinch.name, Drag.name, Push.name}
        edge = -self.workspace[0] / 2 - EDGE if at_edge else None
        return Setting(self.scenes, self.objects_per_scene, self.workspace, self.seed, edge)

    @property
    def stages(self) -> tuple[str, ...]:
        """The stages that follow the proposers."""
        return tuple(stage for stage in STAGES if stage not in self.without)


@dataclass(frozen=True)
class Experiment:
    """Rows that stand in one table.

    Attributes:
        name: of the file, without suffix; text: what is asked.
        rows: in the table's order.
        paper: tables of the paper that stand below, names in `report/paper.yaml`.
        mark: name of the marks in a document between which the table goes.
        by_kind: the table splits every row by how the objects lie.
    """

    name: str
    text: str
    rows: tuple[Row, ...]
    paper: tuple[str, ...] = ()
    mark: str = ""
    by_kind: bool = False


def names() -> list[str]:
    """Of the experiments that come with the suite."""
    return sorted(path.stem for path in FOLDER.glob("*.yaml"))


def read_experiment(
    which: str, changes: Mapping[str, Any], weights: Sequence[str] = (), only: Sequence[str] = ()
) -> Experiment:
    """An experiment by the name of a shipped one, or from a file.

    Args:
        changes: keys of a row that replace the file's defaults; what a row itself says stays.
        weights: files of weights, FOLDER/NAME: every row is run with each.
        only: names of the rows that are wanted; none = all.

    Raises:
        ValueError: there is no such experiment or row, a key or value is wrong, or rows are missing or share a folder.
    """
    values = _values(which)
    where = f"experiment {which}"
    written, defaults = values.pop("rows"), {**values.pop("defaults"), **changes}
    rows = tuple(_row(row, defaults, f"{where}, row {k}") for k, row in enumerate(written, 1))
    known = [row.name for row in rows]
    for name in only:
        if name not in known:
            raise ValueError(f"no row named {name!r}; there are {', '.join(known)}")
    files = [Path(one) for one in weights]
    rows = tuple(each for row in rows if not only or row.name in only for each in _with_weights(row, files))
    folders = [row.name for row in rows]
    if doubled := next((name for name in folders if folders.count(name) > 1), ""):
        raise ValueError(f"{where}: several rows are named {doubled!r}, and so would be their folders")
    name = Path(which).stem
    values = {"mark": name.replace("_", "-"), **values, "name": name, "rows": rows}
    experiment = checked(Experiment, values, where)
    if not rows:
        raise ValueError(f"{where}: it has no rows")
    return experiment


def _values(which: str, extending: tuple[str, ...] = ()) -> dict[str, Any]:
    """The file's keys; rows and defaults, which are there in any case, after those of the file that it `extends`.

    Its place in a document is not that file's.

    Args:
        extending: those that extend it.
    """
    if which in extending:
        raise ValueError(f"{which} extends itself")
    file = Path(which) if which.endswith((".yaml", ".yml")) else FOLDER / f"{which}.yaml"
    if not file.is_file():
        raise ValueError(f"no experiment named {which!r}; there are {', '.join(names())}, and files")
    try:
        values = load_yaml(file.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise ValueError(f"{file} is no YAML: {error}") from error
    if not isinstance(values, dict):
        raise ValueError(f"{file} holds no keys")
    rows, defaults, base = values.get("rows") or [], values.get("defaults") or {}, values.pop("extends", None)
    if not isinstance(rows, list) or not isinstance(defaults, dict):
        raise ValueError(f"{file}: rows are a list, defaults are keys")
    if base is None:
        return {**values, "defaults": defaults, "rows": rows}
    if not isinstance(base, str):
        raise ValueError(f"{file}: extends is {base!r}, it must name an experiment")
    first = _values(base, (*extending, which))
    first.pop("mark", None)
    return {**first, **values, "defaults": {**first["defaults"], **defaults}, "rows": [*first["rows"], *rows]}


def _row(written: Any, defaults: Mapping[str, Any], where: str) -> Row:
    if not isinstance(written, Mapping):
        raise ValueError(f"{where} is {written!r}, it must hold keys")
    values = {**defaults, **written}
    if "condition" in values:
        values["condition"] = checked(Condition, values["condition"], f"{where}, condition")
    return checked(Row, values, where)


def checked(kind: type[T], values: Mapping[str, Any], where: str) -> T:
    """A dataclass from the keys of a file; lists become tuples.

    Raises:
        ValueError: a key is unknown or missing, or a value is of the wrong type.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"{where} is {values!r}, it must hold keys")
    types = get_type_hints(kind)
    given: dict[str, Any] = {key: tuple(v) if isinstance(v, list) else v for key, v in values.items()}
    for key, value in given.items():
        if key not in types:
            raise ValueError(f"{where}: no key {key!r}; there are {', '.join(types)}")
        if not _fits(value, wanted := types[key]):
            shown = wanted if get_args(wanted) else wanted.__name__
            raise ValueError(f"{where}: {key} is {value!r}, it must be of type {shown}")
    missing = [f.name for f in fields(kind) if f.default is MISSING and f.name not in given]  # type: ignore[arg-type]
    if missing:
        raise ValueError(f"{where}: the key {missing[0]!r} is missing")
    return kind(**given)


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value of a file is of an annotated type: a class, a tuple of some, or one of several."""
    inner = get_args(kind)
    if get_origin(kind) is tuple:
        each = inner[:1] * len(value) if isinstance(value, tuple) and inner[-1] is ... else inner
        return isinstance(value, tuple) and len(value) == len(each) and all(map(_fits, value, each))
    if inner:
        return any(_fits(value, one) for one in inner)
    if isinstance(value, bool):
        return kind is bool
    return isinstance(value, (int, float) if kind is float else kind)


def _with_weights(row: Row, files: Sequence[Path]) -> tuple[Row, ...]:
    """The row with each file of weights, named by it."""
    if not files:
        return (row,)
    return tuple(
        replace(
            row,
            name=f"{file.parent.name}_{file.stem}_{row.name}",
            text=f"{row.text or row.name}, {file.parent.name}/{file.stem}",
            weights=str(file),
        )
        for file in files
    )
