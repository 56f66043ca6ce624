"""`dgs model-card`: writes models/README.md; every number in it comes from a file that a command wrote."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from dgs_description.errors import DgsError, ErrorCode
from dgs_learning import paths
from dgs_learning.cli.refusal import refusals

CURVE_COLUMNS = ("loss", "precision", "recall", "angle_deg", "offset_mm", "j_end_rad")


@dataclass(frozen=True)
class CardFiles:
    """What a card is made of.

    Attributes:
        directory: of the weights; the card and its picture are written there.
        model: name of the weights.
        dataset: dataset file.
        results: folder of evaluation summaries.
        speed: folder of `dgs bench-inference --json` files.
    """

    directory: Path
    model: str
    dataset: Path
    results: Path
    speed: Path

    @property
    def curve(self) -> Path:
        """The curves that are kept with the weights."""
        return self.directory / f"{self.model}_curve.csv"


def model_card(
    run: Annotated[
        Path | None,
        typer.Option(help="Training folder (or curve.csv) whose curves are kept with the weights."),
    ] = None,
    model: Annotated[str, typer.Option(help="Name of the weights.")] = "dgs_net",
    models_dir: Annotated[Path | None, typer.Option(help="Where weights and card lie.")] = None,
    dataset: Annotated[Path | None, typer.Option(help="Dataset file.")] = None,
    results: Annotated[Path | None, typer.Option(help="Folder of evaluation summaries.")] = None,
    speed: Annotated[Path | None, typer.Option(help="Folder of bench-inference results.")] = None,
) -> None:
    """Write the model card README.md beside the weights, with data, configuration, curves, metrics, speed, limits."""
    published = paths.repository() / "docs" / "results"
    files = CardFiles(
        models_dir or paths.models_dir(),
        model,
        dataset or paths.dataset_file(),
        results or published,
        speed or (results or published) / "speed",
    )
    with refusals():
        if run is not None:
            _keep_curve(run / "curve.csv" if run.is_dir() else run, files.curve)
        typer.echo(f"model card: {write_card(files)}")


def _keep_curve(source: Path, target: Path) -> None:
    try:
        shutil.copyfile(source, target)
    except OSError as error:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"the curves cannot be copied: {error}") from error


def write_card(files: CardFiles) -> Path:
    """Write the card and the picture of the curves.

    Raises:
        DgsError: WEIGHTS_MISSING, WEIGHTS_ALTERED, REQUEST_INVALID (a file that is none of ours).
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    from dgs_grasp_planner.network.weights import read_info
    from dgs_learning.evaluation.provenance import revision, today

    info = read_info(files.directory, files.model)
    sidecar = json.loads((files.directory / f"{files.model}.json").read_text(encoding="utf-8"))
    weights = files.directory / sidecar["file"]
    notes = info.notes
    training = notes.get("training")
    if not isinstance(training, dict) or "step" not in notes:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{files.model}.json has no notes of a training")
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        undefined=StrictUndefined,
        trim_blocks=False,
    )
    text = environment.get_template("model_card.md.j2").render(
        model={
            "id": info.model_id,
            "file": weights.name,
            "bytes": weights.stat().st_size,
            "sha256": info.sha256,
            "parameters": sidecar["parameters"],
            "step": notes["step"],
        },
        date=today(),
        revision=revision(),
        training=training,
        config={k: _short(v) for k, v in info.config.to_dict().items()},
        views=notes.get("views"),
        data=_data(files.dataset, notes.get("dataset")),
        data_file=files.dataset.name,
        curve=_curve(files),
        results=_results(files.results, info.sha256),
        results_dir=_in_tree(files.results),
        speed=_speed(files.speed, info.sha256),
        speed_dir=_in_tree(files.speed),
    )
    card = files.directory / "README.md"
    card.write_text(text.rstrip() + "\n", encoding="utf-8")
    return card


def _short(value: Any) -> Any:
    return ", ".join(map(str, value)) if isinstance(value, list) else value


def _in_tree(path: Path) -> str:
    root = paths.repository()
    return str(path.relative_to(root)) if path.is_relative_to(root) else path.name


def _data(file: Path, trained_on: dict[str, Any] | None) -> dict[str, Any] | None:
    """Numbers of the dataset file; None if it is not there."""
    from dgs_grasp_planner.network.weights import file_sha256
    from dgs_learning.dataset import load_dataset
    from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

    if not file.is_file():
        return None
    try:
        data = load_dataset(file)
    except (ValueError, KeyError, OSError) as error:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{file} is no dataset: {error}") from error
    per_object = np.diff(data.first)
    kinds = np.array([model.shape_class for model in data.objects])
    sha256 = file_sha256(file)
    return {
        "file": file.name,
        "bytes": file.stat().st_size,
        "sha256": sha256,
        "same": None if trained_on is None else trained_on.get("sha256") == sha256,
        "objects": len(data.objects),
        "grasps": len(data.grasps),
        "uniform": int((data.grasps.source == "uniform").sum()),
        "scenes": len(data.scenes),
        "scene_objects": sum(len(scene.objects) for scene in data.scenes),
        "scene_grasps": sum(len(scene.instance) for scene in data.scenes),
        "classes": [
            {"name": k, "objects": int((kinds == k).sum()), "grasps": int(per_object[kinds == k].sum())}
            for k in SHAPE_CLASSES
        ],
    }


def _curve(files: CardFiles) -> dict[str, Any] | None:
    """The last row of every split; draws the picture. None without a curve."""
    from dgs_learning.cli.plot_curve import draw_curve
    from dgs_learning.training.curve import read_curve

    if not files.curve.is_file():
        return None
    picture = files.curve.with_suffix(".png")
    draw_curve(files.curve, picture)
    splits = read_curve(files.curve)
    rows = []
    for split, columns in splits.items():
        row = {name: columns[name][-1] if name in columns else math.nan for name in CURVE_COLUMNS}
        texts = {name: "–" if math.isnan(value) else f"{value:.3g}" for name, value in row.items()}
        rows.append({"split": split.replace("_", "-"), "step": int(columns["step"][-1]), **texts})
    last = max(int(columns["step"][-1]) for columns in splits.values())
    return {"file": files.curve.name, "picture": picture.name, "last_step": last, "rows": rows}


def _results(folder: Path, sha256: str) -> list[dict[str, Any]]:
    """Rows of the evaluation summaries."""
    rows = []
    for path in sorted(folder.glob("*.json")):
        summary = _read(path)
        if "objects_per_scene" not in summary.get("setting", {}):
            continue  # other commands keep their figures here too
        try:
            setting = summary["setting"]
            used = setting.get("model_sha256", "")
            same = bool(used) and sha256.startswith(used)
            rows.append(
                {
                    "file": path.stem,
                    "weights": "these" if same else f"*other: {setting['planner']}*",
                    "same": same,
                    "objects": summary["objects"],
                    "scenes": summary["scenes"],
                    "attempts": summary["attempts"],
                    "sr": _percent(summary["sr"], summary["sr_interval"]),
                    "cr": _percent(summary["cr_pooled"], summary["cr_interval"]),
                    "pd": f"{summary['pd_mm']['mean']:.2f}" if summary.get("pd_mm") else "–",
                }
            )
        except (KeyError, TypeError) as error:
            raise DgsError(
                ErrorCode.REQUEST_INVALID, f"{path} is no summary of an evaluation: {error!r} is missing"
            ) from error
    return rows


def _percent(value: float, interval: tuple[float, float]) -> str:
    return f"{value * 100:.1f} ({interval[0] * 100:.1f}–{interval[1] * 100:.1f})"


def _speed(folder: Path, sha256: str) -> list[dict[str, Any]]:
    """Rows of the speed measurements."""
    rows = []
    for path in sorted(folder.glob("*.json")):
        measured = _read(path)
        try:
            machine = measured["machine"]
            rows.append(
                {
                    "machine": machine["gpu"] or machine["processor"],
                    "precision": measured["precision"],
                    "threads": "–" if machine["gpu"] else measured["threads"],
                    "voxels": measured["voxels"],
                    "points_in": measured["points_in"],
                    "points_used": measured["points_used"],
                    "total": f"{measured['total_s'] * 1e3:.1f} ({measured['total_p90_s'] * 1e3:.1f})",
                    "network": f"{measured['network_s'] * 1e3:.1f} ({measured['network_p90_s'] * 1e3:.1f})",
                    "stages": ", ".join(f"{k} {v * 1e3:.1f}" for k, v in measured["stages"].items()),
                    "weights": "these" if measured["model"]["sha256"] == sha256 else "*other*",
                    "load": machine["load_average"],
                    "busy": machine["load_average"] > 0.5 * machine["cores"],
                }
            )
        except (KeyError, TypeError) as error:
            raise DgsError(
                ErrorCode.REQUEST_INVALID, f"{path} is no speed measurement: {error!r} is missing"
            ) from error
    return rows


def _read(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{path} cannot be read: {error}") from error
    if not isinstance(values, dict):
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{path} holds no key-value pairs")
    return values
