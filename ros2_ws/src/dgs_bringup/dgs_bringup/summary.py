"""The figures of a demo run: success rate, clearance rate and seconds per stage, as JSON and as a table. No ROS."""

from __future__ import annotations

import dataclasses
import subprocess
from pathlib import Path
from typing import Any

from rich.table import Table

from dgs_description.errors import ErrorCode


@dataclasses.dataclass(frozen=True)
class Attempt:
    """One executed grasp.

    Attributes:
        score: of the planner.
        success: an object was lifted and held, or came into the bin (ground truth).
        code: what the arm executor reported, 0 = success.
        message: its sentence.
        seconds: wall time per stage [s].
        source: proposer of the grasp.
    """

    score: float
    success: bool
    code: int
    message: str
    seconds: dict[str, float]
    source: str = ""


class Refusals:
    """Collects what the arm said about grasps that it did not execute, look by look."""

    def __init__(self) -> None:
        """Nothing was refused yet."""
        self._looks: list[str] = []
        self._this_look: list[str] = []

    def add(self, stage: str, message: str) -> None:
        """Take in a line of the task's feedback."""
        if stage == "rejected":
            self._this_look.append(message)
        elif stage == "recorded":  # another grasp of the same look was executed
            self._this_look.clear()
        elif stage == "capture":
            self.ended()

    def ended(self) -> list[str]:
        """One entry per look without an attempt; the present look is over."""
        if self._this_look:
            self._looks.append("; ".join(self._this_look))
            self._this_look.clear()
        return self._looks


@dataclasses.dataclass(frozen=True)
class RunSummary:
    """One run. SR = successes / attempts, CR = cleared / objects (both in [0, 1]; 0 without attempts).

    An attempt that was cancelled because the time was up tells nothing about the grasp and is left out.

    Attributes:
        total_seconds: wall time, simulated_seconds: the same on the simulator's clock [s].
        refusals: per look at the table that led to no attempt because the arm could execute no grasp, its sentences.
        places: last known place of every object.
    """

    seed: int
    objects: int
    cleared: int
    records: list[Attempt]
    total_seconds: float
    simulated_seconds: float
    refusals: list[str]
    error_code: int
    message: str
    revision: str
    model: str
    places: dict[str, str]

    def to_json(self) -> dict[str, Any]:
        """Plain data with the keys of summary.json."""
        counted = [record for record in self.records if record.code != ErrorCode.EXECUTION_CANCELLED]
        successes = sum(record.success for record in counted)
        seconds = {"total": self.total_seconds}
        for record in self.records:
            for stage, value in record.seconds.items():
                seconds[stage] = seconds.get(stage, 0.0) + value
        return {
            "objects": self.objects,
            "attempts": len(counted),
            "successes": successes,
            "cleared": self.cleared,
            "sr": round(successes / max(len(counted), 1), 4),
            "cr": round(self.cleared / max(self.objects, 1), 4),
            "seconds": {stage: round(value, 2) for stage, value in seconds.items()},
            "simulated_seconds": round(self.simulated_seconds, 2),
            "refusals": self.refusals,
            "seed": self.seed,
            "error_code": self.error_code,
            "message": self.message,
            "revision": self.revision,
            "model": self.model,
            "places": self.places,
            "records": [dataclasses.asdict(record) for record in self.records],
        }


def summary_table(summary: dict[str, Any]) -> Table:
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


def git_revision(folder: Path) -> str:
    """Short commit hash of the checkout that `folder` lies in, with `-dirty` if files differ; "unknown" without git."""
    command = f"git -C {folder} describe --always --dirty --abbrev=12 --exclude=*".split()
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
