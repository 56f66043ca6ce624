"""A series of runs as one JSON file and one table in the documents."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

KEPT = (
    "scenes", "objects", "attempts", "successes", "sr", "sr_interval", "cr_pooled", "cr_interval", "per_class",
    "failures", "pd_mm", "pv_mm3", "time_s", "setting",
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One run of a series: its name, a text for the table, its summary."""

    name: str
    text: str
    summary: dict[str, Any]


def series_table(rows: Sequence[Row]) -> str:
    """Markdown: SR with its interval, CR, PD and the commonest failure of every run."""
    lines = ["| | SR [%] (95 %) | attempts | CR [%] | PD [mm] | failed |", "|---|---|---|---|---|---|"]
    for row in rows:
        s = row.summary
        low, high = (100 * bound for bound in s["sr_interval"])
        failed = ", ".join(f"{name} {count}" for name, count in s["failures"].items() if count) or "–"
        depth = f"{s['pd_mm']['mean']:.2f}" if s["pd_mm"] else "–"
        rates = f"{100 * s['sr']:.1f} ({low:.1f}–{high:.1f}) | {s['attempts']} | {100 * s['cr_pooled']:.1f}"
        lines.append(f"| {row.text} | {rates} | {depth} | {failed} |")
    return "\n".join(lines)


def series_note(rows: Sequence[Row]) -> str:
    """One line: objects, scenes, seed, weights, revision, date."""
    s = rows[0].summary["setting"]
    low, high = s["objects_per_scene"]
    settings = [row.summary["setting"] for row in rows]
    weights = ", ".join(dict.fromkeys(f"`{s['model_sha256']}`" for s in settings if "model_sha256" in s))
    revisions = ", ".join(dict.fromkeys(f"`{r.summary['setting']['revision']}`" for r in rows))
    return (
        f"{s['scenes']} scenes of {low} to {high} objects ({s['objects']['name']}) each, seed {s['seed']}, "
        f"weights {weights}, revision {revisions}, {rows[-1].summary['setting']['date']}."
    )


def write_series(path: Path, rows: Sequence[Row]) -> None:
    """The summaries without the spreads that nobody tabulates."""
    kept = [{"name": r.name, "text": r.text, **{k: r.summary[k] for k in KEPT}} for r in rows]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"series": path.stem, "rows": kept}, indent=1) + "\n")
