"""What a number must come with: revision of the program, date, objects and weights by their hashes."""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from dgs_grasp_planner.planner import STAGES
from dgs_learning import paths
from dgs_sim_bridge.render.object_model import ObjectModel, catalogue_to_arrays

if TYPE_CHECKING:  # the baselines bring the simulation along, which a summary does not need
    from dgs_learning.evaluation.proposers import PlannerChoice


def revision() -> str:
    """Short commit of the source tree, `+` behind it when tracked files differ; "unknown" without git."""

    def git(*words: str) -> str:
        run = subprocess.run(
            ["git", "-C", str(paths.repository()), *words],
            capture_output=True,
            text=True,
            check=True,
            timeout=30,
        )
        return run.stdout.strip()

    try:
        head = git("rev-parse", "--short=10", "HEAD")
        changed = git("status", "--porcelain", "--untracked-files=no", "--", "*.py")
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return head + ("+" if changed else "")


def today() -> str:
    """Date in UTC, e.g. 2026-01-31."""
    return datetime.now(UTC).date().isoformat()


def describe_catalogue(name: str, catalogue: Sequence[ObjectModel]) -> dict[str, Any]:
    """Name, number of objects and hash of their shapes, masses and friction."""
    digest = hashlib.sha256()
    for key, array in sorted(catalogue_to_arrays(catalogue).items()):
        digest.update(key.encode() + str(array.dtype).encode() + array.tobytes())
    return {"name": name, "objects": len(catalogue), "sha256": digest.hexdigest()[:16]}


def describe_planner(choice: PlannerChoice) -> dict[str, Any]:
    """Proposers and stages; of the network also the weights, of those that need it the dataset, with hashes."""
    described: dict[str, Any] = {
        "proposers": list(choice.proposers),
        "stages": [stage for stage in STAGES if stage not in choice.without],
        "ablate": choice.ablate,
    }
    if {"random_prior", "replay", "true_point", "true_rest"} & set(choice.proposers):
        file = choice.dataset or paths.dataset_file()
        digest = hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""
        described |= {"dataset": file.name, "dataset_sha256": digest[:16]}
    if {"dgs_net", "true_point", "true_rest"} & set(choice.proposers):
        card = (choice.models_dir or paths.models_dir()) / f"{choice.model}.json"
        sha256 = json.loads(card.read_text()).get("sha256", "") if card.is_file() else ""
        described |= {"model": choice.model, "model_sha256": sha256[:16]}
    return described
