"""The rows of an experiment as one JSON file and one table in a document."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dgs_description.documents import fill_block
from dgs_learning.evaluation.experiment import Experiment
from dgs_learning.evaluation.metrics import clearance, success
from dgs_learning.evaluation.report.templates import read_data, render


def experiment_result(experiment: Experiment, summaries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """What the JSON file holds: the experiment, and the summaries of its rows with their names."""
    pairs = zip(experiment.rows, summaries, strict=True)
    rows = [{"name": row.name, "text": row.text, **summary} for row, summary in pairs]
    head = {"experiment": experiment.name, "text": experiment.text, "mark": experiment.mark}
    return {**head, "paper": list(experiment.paper), "by_kind": experiment.by_kind, "rows": rows}


def together(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """SR and CR over all sets of objects, one for every engine and condition: what stands behind the set in `text`."""
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row["text"].partition(", ")[2], []).append(row)
    return [
        {
            "text": text,
            **success(sum(row["successes"] for row in group), sum(row["attempts"] for row in group)),
            **clearance([(row["cleared"], row["objects"]) for row in group]),
        }
        for text, group in groups.items()
    ]


def read_result(file: Path) -> dict[str, Any]:
    """The contents of such a file.

    Raises:
        ValueError: it is none.
    """
    try:
        result = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ValueError(f"{file} cannot be read: {error}") from error
    if not isinstance(result, dict) or not {"experiment", "rows", "mark", "paper"} <= set(result):
        raise ValueError(f"{file} is no result of `dgs experiment`")
    return result


def experiment_table(result: dict[str, Any], brief: bool = False) -> str:
    """Markdown: the free hand's rows, then the robot's, with the paper's rows below, and one line of provenance.

    Args:
        result: as `experiment_result` gives it.
        brief: only SR and CR of what ships, beside the paper's DGS-Net.
    """
    rows = result["rows"]
    robots = [row for row in rows if row["setting"].get("protocol") == "robot"]
    weights = [row["setting"]["model_sha256"] for row in rows if "model_sha256" in row["setting"]]
    tables = read_data("paper")
    full = "exam.md" if result.get("by_kind") else "experiment.md"
    return render(
        "brief.md" if brief else full,
        name=result["experiment"],
        rows=rows,
        free=[row for row in rows if row not in robots],
        robots=robots,
        together=together(rows) if result.get("by_kind") else [],
        paper=[row for table in result["paper"] for row in tables[table]],
        weights=list(dict.fromkeys(weights)),
    )


def fill_document(document: Path, result: dict[str, Any]) -> bool:
    """Put the table between the experiment's marks, the brief one between those that end in `-brief`.

    Returns:
        Whether that changed the file.

    Raises:
        ValueError: the document lacks the marks.
    """
    brief = f"{result['mark']}-brief"
    if f"<!-- {brief}:start -->" in document.read_text(encoding="utf-8"):
        return fill_block(document, brief, experiment_table(result, brief=True))
    return fill_block(document, result["mark"], experiment_table(result))
