"""Which faults are injected at which stage of a pick, and what end each must have. No ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from dgs_description.errors import ErrorCode

STAGES = ("planning", "transfer", "approach", "close", "lift", "carry", "release", "home")
ARM_STAGES = ("transfer", "approach", "lift", "carry", "home")

CANCEL, STOP, FREEZE = "cancel", "stop", "freeze_camera"
"""The first two are asked of the executor itself; all other names are faults of the simulator."""
JAM = "jam_finger"
LIMIT = 2.0
"""Answer and end state must be there within so much simulated time [s]."""

_LATCHING = (STOP, "protective_stop", "emergency_stop")
_CODES = {
    CANCEL: ErrorCode.EXECUTION_CANCELLED,
    STOP: ErrorCode.STOPPED,
    "protective_stop": ErrorCode.PROTECTIVE_STOP,
    "emergency_stop": ErrorCode.PROTECTIVE_STOP,
    "abort_arm_goal": ErrorCode.TRAJECTORY_ABORTED,
    "drop_joint_states": ErrorCode.JOINT_STATES_SILENT,
    JAM: ErrorCode.HAND_BLOCKED,
}
_PICKED = (ErrorCode.SUCCESS, ErrorCode.NOTHING_HELD, ErrorCode.LOST_OBJECT)


@dataclass(frozen=True)
class Case:
    """One fault, `CANCEL`, `STOP` or one of /sim/inject_fault with its target, at one stage of /execute_grasp."""

    fault: str
    stage: str
    target: str = ""

    @property
    def codes(self) -> tuple[ErrorCode, ...]:
        """Codes that the pick may end with."""
        # A finger that is stuck while it closes is one contact more or less; the others may still hold.
        also = _PICKED if (self.fault, self.stage) == (JAM, "close") else ()
        return (_CODES[self.fault], *also)

    @property
    def hand(self) -> str:
        """The state in which the hand must be at the end: open, holds or any."""
        if self.latches or self.fault == JAM:
            return "any"
        return "holds" if self.stage in ("lift", "carry") else "open"

    @property
    def latches(self) -> bool:
        """Whether nothing may move until /reset."""
        return self.fault in _LATCHING

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.fault} {self.target}".strip()


def all_cases() -> list[Case]:
    """Every fault at every stage where it can strike."""
    cases = [Case(fault, stage) for fault in (CANCEL, STOP) for stage in STAGES]
    cases += [Case("abort_arm_goal", stage) for stage in ARM_STAGES]
    for fault in ("protective_stop", "emergency_stop", "drop_joint_states"):
        cases += [Case(fault, stage) for stage in STAGES[1:]]
    return cases + [Case(JAM, stage, "thumb") for stage in ("transfer", "close", "release")]


@dataclass
class Outcome:
    """What came of one case; times in simulated seconds from the fault on.

    Attributes:
        reached: whether the pick came to the stage at all.
        code, message: of the pick's result.
        answered: until the result was there.
        settled: until arm and hand were in their end state; None = they were not within the limit.
        stood: whether the arm stayed where it was, also after the fault was over, until the reset.
        truthful: whether what the result says about the object is so.
        home: error code of /go_home after /reset.
        next_pick, next_message: error code and message of the pick after that, which must run to its end.
    """

    case: Case
    reached: bool = False
    code: int = -1
    message: str = ""
    answered: float | None = None
    settled: float | None = None
    stood: bool = False
    truthful: bool = False
    home: int = -1
    next_pick: int = -1
    next_message: str = ""

    def problems(self) -> list[str]:
        """What is not as it must be."""
        if not self.reached:
            return ["stage not reached"]
        # With a jammed finger the pick goes on to its own end, so the arm need not stand after two seconds.
        ends = self.case.fault != JAM
        checks = (
            (self.code in self.case.codes, f"code {self.code}"),
            (not ends or _within(self.answered), f"answered after {self.answered} s"),
            (not ends or _within(self.settled), f"end state after {self.settled} s"),
            (not ends or self.stood, "the arm moved afterwards"),
            (self.truthful, "untrue about the object"),
            (self.home == 0, f"/go_home answered {self.home}"),
            (self.next_pick in _PICKED, f"next pick ended with {self.next_pick} {self.next_message}"),
        )
        return [problem for right, problem in checks if not right]


def table(outcomes: Iterable[Outcome]) -> list[dict[str, object]]:
    """Rows by fault: trials, how many were right, slowest answer and end state, what went wrong."""
    rows: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        rows.setdefault(outcome.case.name, []).append(outcome)
    return [
        {
            "fault": name,
            "stages": sorted({o.case.stage for o in group}, key=STAGES.index),
            "trials": len(group),
            "right": sum(not o.problems() for o in group),
            "slowest_answer_s": _largest(o.answered for o in group),
            "slowest_end_state_s": _largest(o.settled for o in group),
            "problems": [f"{o.case.stage}: {', '.join(p)}" for o in group if (p := o.problems())],
        }
        for name, group in rows.items()
    ]


def document_table(report: Mapping[str, Any]) -> str:
    """Markdown of what `python -m tests.faults --json` writes."""
    lines = [
        "| fault | at | trials | right | slowest answer, end state [s, simulated] | not right |",
        "|---|---|---|---|---|---|",
    ]
    for row in report["faults"]:
        slowest = (row["slowest_answer_s"], row["slowest_end_state_s"])
        seconds = ", ".join("–" if value is None else f"{value:.2f}" for value in slowest)
        cells = [row["fault"], ", ".join(row["stages"]), row["trials"], row["right"], seconds]
        lines.append("| " + " | ".join(map(str, cells)) + f" | {'; '.join(row['problems']) or '–'} |")
    camera = report["freeze_camera"]
    if camera is not None:
        told = f"{camera['diagnosed_wall_seconds']} (wall time)"
        lines.append(
            f"| freeze_camera | looking | 1 | {int(camera['right'])} | {told} | "
            f"that is what `/diagnostics` takes to say {int(ErrorCode.CAMERA_SILENT)}; `/clear_table` answers "
            f"{camera['code']} after {camera['wall_seconds']} s, the arm stands at home meanwhile |"
        )
    about = f"measured {report['date']}, scene seed {report['seed']}"
    return "\n".join([*lines, "", f"{report['right']} of {report['trials']} trials right, {about}."])


def _within(seconds: float | None) -> bool:
    return seconds is not None and seconds <= LIMIT


def _largest(values: Iterable[float | None]) -> float | None:
    return max((round(value, 3) for value in values if value is not None), default=None)
