"""Writes the model card beside the weights; every number in it comes from a file that a command wrote."""

from __future__ import annotations

import json
import math
from functools import partial
from pathlib import Path
from typing import Any

from jinja2 import UndefinedError

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand_file import load_hand
from dgs_description.paths import revision, today
from dgs_grasp_planner.network.weights import file_sha256, read_info
from dgs_learning import paths
from dgs_learning.dataset import load_dataset
from dgs_learning.evaluation.report.curves import draw_curve
from dgs_learning.evaluation.report.tables import experiment_table
from dgs_learning.evaluation.report.templates import read_data, render
from dgs_learning.inspection.tables import describe
from dgs_learning.training.curve import read_curve

CURVE_COLUMNS = ("loss", "precision", "recall", "angle_deg", "offset_mm", "j_end_rad")

_refused = partial(DgsError, ErrorCode.REQUEST_INVALID)


def curve_file(directory: Path, model: str) -> Path:
    """The curves that are kept with the weights."""
    return directory / f"{model}_curve.csv"


def write_card(directory: Path, model: str, dataset: Path, results: Path) -> Path:
    """Write the card of the weights `model` in a directory, beside them, and the picture of their curves.

    Args:
        dataset: its file.
        results: folder of experiments; in `speed` are the files of `dgs bench-inference --json`.

    Raises:
        DgsError: WEIGHTS_MISSING, WEIGHTS_ALTERED, REQUEST_INVALID (a file that is none of ours).
    """
    info, speed = read_info(directory, model), results / "speed"
    notes = info.notes
    if not isinstance(notes.get("training"), dict) or "step" not in notes:
        raise _refused(f"{model}.json has no notes of a training")
    sidecar = _read(directory / f"{model}.json")
    try:
        text = render(
            "model_card.md",
            info=info,
            hand=load_hand(info.hand).title,
            sidecar=sidecar,
            bytes=(directory / sidecar["file"]).stat().st_size,
            date=today(),
            revision=revision(),
            training=notes["training"],
            config=info.config.to_dict(),
            deviations=read_data("deviations"),
            views=notes.get("views"),
            data=_data(dataset, notes.get("dataset")),
            curve=_curve(curve_file(directory, model)),
            results=_results(results, info.sha256),
            speed=[_read(path) for path in sorted(speed.glob("*.json"))],
            folders={"dataset": _in_tree(dataset), "results": _in_tree(results), "speed": _in_tree(speed)},
        )
    except (KeyError, TypeError, UndefinedError) as error:
        said = f"a file of {results} or {speed} is no result of ours: {error} is missing"
        raise _refused(said) from error
    card = directory / "README.md"
    card.write_text(text + "\n", encoding="utf-8")
    return card


def _in_tree(path: Path) -> str:
    root = paths.repository()
    return str(path.relative_to(root)) if path.is_relative_to(root) else path.name


def _read(path: Path) -> dict[str, Any]:
    try:
        values = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise _refused(f"{path} cannot be read: {error}") from error
    if not isinstance(values, dict):
        raise _refused(f"{path} holds no key-value pairs")
    return values


def _data(file: Path, trained_on: dict[str, Any] | None) -> dict[str, Any] | None:
    """Numbers of the dataset file, as `dgs inspect` counts them; None if it is not there."""
    if not file.is_file():
        return None
    try:
        counts = describe(load_dataset(file))
    except (ValueError, KeyError, OSError) as error:
        raise _refused(f"{file} is no dataset: {error}") from error
    sha256 = file_sha256(file)
    other = None if trained_on is None or trained_on.get("sha256") == sha256 else trained_on
    about = {"file": file.name, "bytes": file.stat().st_size, "sha256": sha256}
    return {**about, "known": trained_on is not None, "other": other, **counts}


def _curve(file: Path) -> dict[str, Any] | None:
    """The last row of every split; draws the picture. None without a curve."""
    if not file.is_file():
        return None
    picture = file.with_suffix(".png")
    draw_curve(file, picture)
    rows = {}
    for split, columns in read_curve(file).items():
        last = [columns[name][-1] if name in columns else math.nan for name in CURVE_COLUMNS]
        texts = ["–" if math.isnan(value) else f"{value:.3g}" for value in last]
        rows[split.replace("_", "-")] = [str(int(columns["step"][-1])), *texts]
    return {"file": file.name, "picture": picture.name, "rows": rows}


def _results(folder: Path, sha256: str) -> list[dict[str, Any]]:
    """Experiments that stand beside the paper's: text, table, and the rows that were measured with other weights."""
    results = []
    for path in sorted(folder.glob("*.json")):
        result = _read(path)
        if not result.get("paper"):
            continue  # other figures, and experiments that the paper has no counterpart of
        used = {row["name"]: row["setting"].get("model_sha256", "") for row in result["rows"]}
        others = [name for name, model in used.items() if not sha256.startswith(model)]
        table = experiment_table(result)
        results.append({"name": path.stem, "text": result["text"], "table": table, "others": others})
    return results
