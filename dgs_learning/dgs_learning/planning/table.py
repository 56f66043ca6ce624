"""The measured planning as a Markdown table, put between two marks of a document."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from dgs_description.documents import fill_block


def table(measured: dict[str, Any]) -> str:
    """Markdown of the figures that `dgs bench-planning --json` writes."""
    planning, check = measured["planning"], measured["check"]
    rows = [
        ("scenes (4 to 6 novel objects), of these with candidates", _counts(measured)),
        (
            "planning of the whole pick, processor time [ms]: median, 95 %, largest",
            _ms(planning["processor_ms"]),
        ),
        ("RRT-Connect, whole pick, no timing [ms]", _ms(measured["baseline"]["whole_pick"]["processor_ms"])),
        (
            "RRT-Connect, to the stand-off only [ms]",
            _ms(measured["baseline"]["to_stand_off"]["processor_ms"]),
        ),
        ("scenes with a grasp that exhaustive search reaches", str(measured["reachable_scenes"])),
        ("of these: the planner finds one", _percent(measured["share_found"])),
        ("of these: it finds the best-scored one", _percent(measured["share_best_scored"])),
        ("RRT-Connect finds a whole pick", str(measured["baseline"]["whole_pick"]["solved"])),
        ("rejected candidates before the chosen one", _reasons(measured["rejected_candidates"])),
        ("picks driven through PyBullet every 2 ms, states", f"{check['picks']}, {check['states']}"),
        ("picks with a contact that is not intended", f"{check['picks_with_collision']}{_contacts(check)}"),
        (
            "states beyond a joint limit, a velocity limit",
            f"{check['position_violations']}, {check['velocity_violations']}",
        ),
        (
            "largest share of the velocity, the acceleration limits",
            f"{check['largest_velocity_share']:.3f}, {check['largest_acceleration_share']:.3f}",
        ),
    ]
    machine, revisions = measured["machine"], ", ".join(f"`{name}`" for name in measured["revisions"])
    lines = ["| what | measured |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows), ""]
    lines.append(
        f"`{measured['command']}`, {measured['date']}, revision {revisions}, one core of "
        f"{machine['processor']} at a load of {machine['load_average']:g} on {machine['cores']} cores, therefore "
        f"processor time; wall time was {_ms(planning['wall_ms'])} ms."
    )
    return "\n".join(lines)


def fill(document: Path, measured: dict[str, Any]) -> None:
    """Rewrite what stands between the marks.

    Raises:
        ValueError: the document lacks them.
    """
    fill_block(document, "planning", table(measured))


def _counts(measured: dict[str, Any]) -> str:
    return f"{measured['scenes']}, {measured['scenes'] - measured['scenes_without_candidates']}"


def _ms(spread: dict[str, float]) -> str:
    return ", ".join(f"{spread[name]:.0f}" for name in ("median", "p95", "largest")) if spread else "–"


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{share * 100:.1f} %"


def _reasons(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items()) or "none"


def _contacts(check: dict[str, Any]) -> str:
    if not check["collisions"]:
        return ""
    pairs = ", ".join(f"{name} ({count})" for name, count in check["collisions"].items())
    return f": {pairs}, at most {check['deepest_mm']:g} mm deep"
