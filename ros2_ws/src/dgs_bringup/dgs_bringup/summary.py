"""The figures of a demo run: success rate, clearance rate and seconds per stage, as JSON and as a table. No ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.table import Table

from dgs_description.errors import ErrorCode


def summarise(
    records: Sequence[Mapping[str, Any]], places: Mapping[str, str], total_seconds: float, **further: Any
) -> dict[str, Any]:
    """Contents of summary.json. SR = successes / attempts, CR = cleared / objects (0 without attempts).

    An attempt that was cancelled because the time was up tells nothing about the grasp and is left out of the counts.

    Args:
        records: one per executed grasp: score, success (an object was lifted and held, or came into the bin), code and
            message of the arm executor, seconds per stage [s of wall time], source (proposer of the grasp).
        places: last known place of every object.
        total_seconds: wall time of the run [s]; `further` goes into the file, too.
    """
    counted = [record for record in records if record["code"] != ErrorCode.EXECUTION_CANCELLED]
    successes = sum(record["success"] for record in counted)
    cleared = sum(place == "bin" for place in places.values())
    seconds = {"total": total_seconds}
    for record in records:
        for stage, value in record["seconds"].items():
            seconds[stage] = seconds.get(stage, 0.0) + value
    return {
        "objects": len(places),
        "attempts": len(counted),
        "successes": successes,
        "cleared": cleared,
        "sr": round(successes / max(len(counted), 1), 4),
        "cr": round(cleared / max(len(places), 1), 4),
        "seconds": {stage: round(value, 2) for stage, value in seconds.items()},
        **further,
        "places": places,
        "records": records,
    }


def true_records(records: Iterable[Any], outcomes: Mapping[int, bool]) -> list[dict[str, Any]]:
    """The task's records with what really happened, where that is known.

    Args:
        records: messages PickRecord, one per executed grasp.
        outcomes: by the number of the attempt; pushes, which have no record, have that of the grasp that follows.
    """
    return [
        {
            "score": round(record.score, 4),
            "success": outcomes.get(record.attempt, record.success),
            "code": record.error_code,
            "message": record.message,
            "seconds": {stage.stage: round(stage.seconds, 3) for stage in record.stage_times},
            "source": record.source,
        }
        for record in records
    ]


def summary_table(summary: Mapping[str, Any]) -> Table:
    """The figures of a summary.json for the terminal."""
    table = Table(show_header=False)
    attempts = summary["attempts"]
    table.add_row("attempts", str(attempts))
    table.add_row("successes", f"{summary['successes']} (SR {100 * summary['sr']:.0f} %)")
    cleared = f"{summary['cleared']} of {summary['objects']} objects (CR {100 * summary['cr']:.0f} %)"
    table.add_row("cleared", cleared)
    table.add_section()
    for stage, seconds in summary["seconds"].items():
        mean = f", {seconds / attempts:.1f} s per attempt" if attempts else ""
        table.add_row(stage, f"{seconds:.1f} s{mean}")
    return table


def refused_looks(feedback: Iterable[tuple[str, str]]) -> list[str]:
    """What the arm said, per look at the table that led to no attempt, of the task's stages and messages in order."""
    looks, refusals = [], []
    for stage, message in [*feedback, ("capture", "")]:
        if stage == "rejected":
            refusals.append(message)
        elif stage == "recorded":  # another grasp of the same look was executed
            refusals = []
        elif stage == "capture" and refusals:
            looks.append("; ".join(refusals))
            refusals = []
    return looks
