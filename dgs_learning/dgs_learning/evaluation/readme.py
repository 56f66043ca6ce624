"""Fills the results block of the README from the committed summaries in docs/results."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dgs_description.documents import fill_block
from dgs_learning.evaluation.paper import TABLE_3, TABLE_4, TABLE_5, PaperRow
from dgs_learning.evaluation.report import planner_label, setting_label
from dgs_learning.evaluation.robot_metrics import ARM_FAILURES, GRASP_FAILURES, UNREACHABLE
from dgs_learning.evaluation.robot_report import robot_setting_label

ORDER = ("dgs_net", "top_down", "random_prior", "replay")


def published_name(summary: dict[str, Any]) -> str:
    """File name of a summary in docs/results, e.g. `dgs_net_novel_4-6_seed0.json` or `robot_4-6_seed0.json`."""
    setting = summary["setting"]
    low, high = setting["objects_per_scene"]
    objects = setting["objects"]["name"]
    count = str(low) if low == high else f"{low}-{high}"
    if _is_robot(summary):
        return f"robot{'' if objects == 'novel' else '_' + objects}_{count}_seed{setting['seed']}.json"
    ablate = "" if setting["ablate"] == "none" else f"_without_{setting['ablate']}"
    ablate += "".join(f"_without_{stage}" for stage in setting.get("without", ()))
    return f"{setting['planner']}{ablate}_{objects}_{count}_seed{setting['seed']}.json"


def _is_robot(summary: dict[str, Any]) -> bool:
    return bool(summary["setting"].get("protocol") == "robot")


def publish(folders: Sequence[Path], results: Path) -> list[Path]:
    """Copy the summaries of finished runs to docs/results.

    Raises:
        FileNotFoundError: a folder has no summary.
    """
    results.mkdir(parents=True, exist_ok=True)
    written = []
    for folder in folders:
        source = folder / "summary.json"
        target = results / published_name(json.loads(source.read_text()))
        shutil.copyfile(source, target)
        written.append(target)
    return written


def load_published(results: Path) -> list[dict[str, Any]]:
    """Summaries of docs/results: by number of objects, the network first, the full planner before its ablations."""
    found = [json.loads(path.read_text()) for path in sorted(results.glob("*.json"))]
    # Other commands keep their figures here too.
    summaries = [s for s in found if "objects_per_scene" in s.get("setting", {})]

    def rank(summary: dict[str, Any]) -> tuple:
        setting = summary["setting"]
        planner = ORDER.index(setting["planner"]) if setting["planner"] in ORDER else len(ORDER)
        return (
            *setting["objects_per_scene"],
            setting["objects"]["name"],
            planner,
            setting["ablate"] != "none",
            setting["ablate"],
        )

    return sorted(summaries, key=rank)


def _row(summary: dict[str, Any]) -> str:
    low, high = (bound * 100 for bound in summary["sr_interval"])
    pd, pv, spread = summary["pd_mm"], summary["pv_mm3"], summary["diversity"]
    cells = [
        planner_label(summary["setting"]),
        setting_label(summary),
        f"{summary['sr'] * 100:.1f} ({low:.1f}–{high:.1f})",
        f"{summary['cr_pooled'] * 100:.1f}",
        f"{pd['mean']:.2f}" if pd else "–",
        f"{pv['mean']:.0f}" if pv else "–",
        "–" if spread is None else f"{spread * 100:.1f}",
        f"{summary['time_s'].get('mean', 0.0):.2f}",
    ]
    return f"| {' | '.join(cells)} |"


def _paper_row(row: PaperRow) -> str:
    """The paper gives PD, PV and D for ten objects only."""
    quality = next(q for q in TABLE_4 if q.name == row.name) if row.setting.startswith("10 ") else row
    shown = [
        "–" if value is None else f"{value:{form}}"
        for value, form in (
            (quality.pd_mm and quality.pd_mm[0], ".3f"),
            (quality.pv_mm3 and quality.pv_mm3[0], ".0f"),
            (quality.diversity and quality.diversity * 100, ".1f"),
        )
    ]
    rates = [f"{(value or 0.0) * 100:.1f}" for value in (row.sr, row.cr)]
    return f"| *paper: {row.name}* | {row.setting} | {' | '.join([*rates, *shown])} | {row.time_s} |"


def _level_pinches(summaries: Sequence[dict[str, Any]]) -> str:
    """How many attempts of the whole planner, nothing left out of it, came from geometry."""
    whole = [s for s in summaries if s["setting"].get("ablate", "none") == "none"]
    whole = [s for s in whole if s.get("level_pinches", {}).get("attempts")]
    if not whole:
        return ""
    attempts, successes = (sum(s["level_pinches"][key] for s in whole) for key in ("attempts", "successes"))
    total = sum(s["attempts"] for s in whole)
    return (
        f" DGS-Net is the whole planner ([steps](docs/architecture.md)): {attempts} of its {total} attempts were "
        f"level pinches proposed by geometry ({successes / attempts * 100:.1f} % succeeded)."
    )


def results_block(summaries: Sequence[dict[str, Any]]) -> str:
    """Markdown between the two marks."""
    if not summaries:
        return "Not measured yet: `dgs report --readme` writes this block from `docs/results`."
    head = "| planner | setting | SR [%] (95 %) | CR [%] | PD [mm] | PV [mm³] | D [%] | time [s] |"
    lines = [head, "|---|---|---|---|---|---|---|---|", *(_row(summary) for summary in summaries)]
    lines += [
        _paper_row(row) for row in TABLE_3 if row.name == "DGS-Net" and "the paper's objects" in row.setting
    ]
    settings = [summary["setting"] for summary in summaries]
    dates = sorted({s["date"] for s in settings})
    revisions = ", ".join(f"`{r}`" for r in dict.fromkeys(s["revision"] for s in settings))
    seeds = ", ".join(str(s) for s in sorted({s["seed"] for s in settings}))
    when = dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}"
    lines += [
        "",
        f"Free hand in simulation, measured {when} at revision {revisions}, seed {seeds}, by `dgs evaluate` "
        "([how](docs/evaluation.md)). The paper's rows are on other objects and another simulator. "
        "PD and PV are of the predicted hand." + _level_pinches(summaries),
    ]
    return "\n".join(lines)


def robot_block(summaries: Sequence[dict[str, Any]]) -> str:
    """Markdown on the runs of the robot protocol; empty where there are none."""
    if not summaries:
        return ""
    lines = [
        "",
        "| method | setting | SR [%] (95 %) | SR without faults of arm and hand [%] | CR [%] | simulated time [s] |",
        "|---|---|---|---|---|---|",
    ]
    for s in summaries:
        low, high = (bound * 100 for bound in s["sr_interval"])
        rates = f"{s['sr'] * 100:.1f} ({low:.1f}–{high:.1f}) | {s['sr_grasp'] * 100:.1f} | {s['cr_pooled'] * 100:.1f}"
        lines.append(f"| DGS-Net | {robot_setting_label(s)} | {rates} | {s['time_s']['simulated']:.1f} |")
    lines += [
        f"| *paper: {row.name}* | {row.setting} | {(row.sr or 0) * 100:.1f} | – | {(row.cr or 0) * 100:.1f} | – |"
        for row in TABLE_5
    ]
    lines.append("")
    for s in summaries:
        failures = ", ".join(f"{kind} {s['failures'][kind]}" for kind in (*GRASP_FAILURES, *ARM_FAILURES))
        setting = s["setting"]
        lines.append(
            f"The whole suite in simulation (`dgs evaluate --arm`), measured {setting['date']} at revision "
            f"`{setting['revision']}`, seed {setting['seed']}. Failed attempts: {failures}. "
            f"Looks at the table with {UNREACHABLE}: {s['failures'][UNREACHABLE]}. Time is per attempt."
        )
    return "\n".join(["", *lines])


def fill_readme(readme: Path, results: Path) -> bool:
    """Rewrite the block between the marks; True when that changed the file.

    Raises:
        ValueError: the README lacks the marks.
    """
    published = load_published(results)
    block = results_block([s for s in published if not _is_robot(s)])
    return fill_block(readme, "results", block + robot_block([s for s in published if _is_robot(s)]))
