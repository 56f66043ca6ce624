"""The figures of a demo run: success rate, clearance rate and seconds per stage, as JSON and as a table. No ROS."""

from __future__ import annotations

import dataclasses
import json
import subprocess
from collections.abc import Sequence
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
            self._end_look()

    def ended(self) -> tuple[str, ...]:
        """One entry per look without an attempt."""
        self._end_look()
        return tuple(self._looks)

    def _end_look(self) -> None:
        if self._this_look:
            self._looks.append("; ".join(self._this_look))
            self._this_look.clear()


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
    records: tuple[Attempt, ...]
    total_seconds: float
    error_code: int
    message: str
    revision: str
    model: str = ""
    simulated_seconds: float = 0.0
    refusals: tuple[str, ...] = ()
    places: dict[str, str] = dataclasses.field(default_factory=dict)

    @property
    def counted(self) -> list[Attempt]:
        """The attempts that were carried through."""
        return [record for record in self.records if record.code != ErrorCode.EXECUTION_CANCELLED]

    @property
    def successes(self) -> int:
        """Attempts that lifted an object."""
        return sum(record.success for record in self.counted)

    @property
    def sr(self) -> float:
        """Grasp success rate."""
        return self.successes / max(len(self.counted), 1)

    @property
    def cr(self) -> float:
        """Scene clearance rate."""
        return self.cleared / max(self.objects, 1)

    @property
    def seconds(self) -> dict[str, float]:
        """Wall time: `total` of the run, then the sum per stage [s]."""
        stages: dict[str, float] = {}
        for record in self.records:
            for stage, seconds in record.seconds.items():
                stages[stage] = stages.get(stage, 0.0) + seconds
        return {"total": self.total_seconds, **stages}

    def to_json(self) -> dict[str, Any]:
        """Plain data with the keys of summary.json."""
        return {
            "objects": self.objects,
            "attempts": len(self.counted),
            "successes": self.successes,
            "cleared": self.cleared,
            "sr": round(self.sr, 4),
            "cr": round(self.cr, 4),
            "seconds": {stage: round(value, 2) for stage, value in self.seconds.items()},
            "simulated_seconds": round(self.simulated_seconds, 2),
            "refusals": list(self.refusals),
            "seed": self.seed,
            "error_code": self.error_code,
            "message": self.message,
            "revision": self.revision,
            "model": self.model,
            "places": self.places,
            "records": [dataclasses.asdict(record) for record in self.records],
        }

    def write(self, path: Path) -> None:
        """Write summary.json."""
        path.write_text(json.dumps(self.to_json(), indent=2) + "\n")

    def table(self) -> Table:
        """The figures for the terminal."""
        table = Table(show_header=False)
        attempts = len(self.counted)
        table.add_row("attempts", str(attempts))
        table.add_row("successes", f"{self.successes} (SR {100 * self.sr:.0f} %)")
        table.add_row("cleared", f"{self.cleared} of {self.objects} objects (CR {100 * self.cr:.0f} %)")
        table.add_section()
        for stage, seconds in self.seconds.items():
            mean = f", {seconds / attempts:.1f} s per attempt" if attempts else ""
            table.add_row(f"{stage}", f"{seconds:.1f} s{mean}")
        return table


def git_revision(folder: Path) -> str:
    """Short commit hash of the checkout that `folder` lies in, with `-dirty` if files differ; "unknown" without git."""
    command: Sequence[str] = (
        "git",
        "-C",
        str(folder),
        "describe",
        "--always",
        "--dirty",
        "--abbrev=12",
        "--exclude=*",
    )
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return "unknown"
