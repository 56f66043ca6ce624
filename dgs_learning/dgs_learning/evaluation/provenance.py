"""What a number must come with: revision of the program, date, objects and weights by their hashes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from dgs_description.cell import CELL, Cell
from dgs_description.hand import HAND
from dgs_description.paths import models_dir, today
from dgs_grasp_planner.contact.shape_completion import NAME as SHAPE_COMPLETION
from dgs_grasp_planner.network.weights import file_sha256
from dgs_grasp_planner.success import FILE as RANKING
from dgs_learning.evaluation.experiment import WITH_NETWORK, Row
from dgs_perception.completion import NAME as DEPTH_COMPLETION
from dgs_perception.depth_source import COMPLETED, ONNX
from dgs_sim_bridge.render.object_model import ObjectModel, catalogue_to_arrays


def write_summary(
    folder: Path, described: dict[str, Any], numbers: dict[str, Any], made_by: Iterable[str]
) -> dict[str, Any]:
    """Write `summary.json` of a run: planner, objects and scenes; the numbers; the revisions that made the scenes."""
    setting = {**described, "revision": ", ".join(dict.fromkeys(made_by)), "date": today()}
    planner = {key: described[key] for key in ("proposers", "stages")}
    summary = {**planner, **numbers, "setting": setting}
    (folder / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
    return summary


def describe_catalogue(name: str, catalogue: Sequence[ObjectModel]) -> dict[str, Any]:
    """Name, number of objects and hash of their shapes, masses and friction."""
    digest = hashlib.sha256()
    for key, array in sorted(catalogue_to_arrays(catalogue).items()):
        digest.update(key.encode() + str(array.dtype).encode() + array.tobytes())
    return {"name": name, "objects": len(catalogue), "sha256": digest.hexdigest()[:16]}


def describe_planner(row: Row) -> dict[str, Any]:
    """Hand, cell, proposers, stages, ablation; hashes of ranking, weights and stored grasps that are used."""
    described: dict[str, Any] = {
        "hand": HAND.name,
        "proposers": row.proposers,
        "stages": list(row.stages),
        "ablate": row.ablate,
        "shape_completion_sha256": _sha256(models_dir() / f"{SHAPE_COMPLETION}.pt"),
        "success_sha256": _sha256(RANKING),
    }
    if Cell() != CELL:
        described["cell"] = {key: value for key, value in vars(CELL).items() if value != vars(Cell())[key]}
    depth_from = row.condition.depth_from
    if depth_from == COMPLETED or depth_from.endswith(ONNX):
        own = models_dir() / f"{DEPTH_COMPLETION}.pt"
        described["depth_sha256"] = _sha256(own if depth_from == COMPLETED else Path(depth_from).expanduser())
    if set(row.proposers) & {"random_prior", "replay", "true_point", "true_rest"}:
        described["dataset"] = row.dataset_file.name
        described["dataset_sha256"] = _sha256(row.dataset_file)
    if set(row.proposers) & set(WITH_NETWORK):
        sidecar = row.models_dir / f"{row.model}.json"
        sha256 = json.loads(sidecar.read_text()).get("sha256", "") if sidecar.is_file() else ""
        described |= {"model": row.model, "model_sha256": sha256[:16]}
    return described


def _sha256(file: Path) -> str:
    """The first 16 digits; empty where there is no file."""
    return file_sha256(file)[:16] if file.is_file() else ""
