"""Which faults are injected at which stage of a pick, and what end each must have. No ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from dgs_description.errors import ErrorCode

Hand = Literal["open", "holds", "any"]

STAGES = ("planning", "pre_grasp", "transfer", "approach", "close", "lift", "carry", "release", "home")
ARM_STAGES = ("transfer", "approach", "lift", "carry", "home")
_CARRYING = ("lift", "carry")
_STOPS = ("stop", "protective_stop", "emergency_stop")

_SLOWEST = ("slowest_answer_s", "slowest_end_state_s")

CANCEL, STOP = "cancel", "stop"
"""Asked of the executor itself; all other names are faults of the simulator."""

_CODES = {
    CANCEL: (ErrorCode.EXECUTION_CANCELLED,),
    STOP: (ErrorCode.STOPPED,),
    "protective_stop": (ErrorCode.PROTECTIVE_STOP,),
    "emergency_stop": (ErrorCode.PROTECTIVE_STOP,),
    "abort_arm_goal": (ErrorCode.TRAJECTORY_ABORTED,),
    "drop_joint_states": (ErrorCode.JOINT_STATES_SILENT,),
}
_PICKED = (ErrorCode.SUCCESS, ErrorCode.NOTHING_HELD, ErrorCode.LOST_OBJECT)


@dataclass(frozen=True)
class Case:
    """One fault at one stage.

    Attributes:
        fault: `CANCEL`, `STOP` or a fault of /sim/inject_fault.
        stage: of /execute_grasp at which it comes.
        target: of the fault.
    """

    fault: str
    stage: str
    target: str = ""

    @property
    def codes(self) -> tuple[ErrorCode, ...]:
        """Codes that the pick may end with."""
        if self.fault == "jam_finger":
            # A finger that is stuck while it closes is one contact more or less; the others may still hold.
            return (*_PICKED, ErrorCode.HAND_BLOCKED) if self.stage == "close" else (ErrorCode.HAND_BLOCKED,)
        return _CODES[self.fault]

    @property
    def hand(self) -> Hand:
        """The state in which the hand must be at the end."""
        if self.fault in _STOPS or self.fault == "jam_finger":
            return "any"
        return "holds" if self.stage in _CARRYING else "open"

    @property
    def latches(self) -> bool:
        """Whether nothing may move until /reset."""
        return self.fault in _STOPS

    @property
    def moves_on(self) -> bool:
        """Whether the pick goes on to its own end, so that the arm need not stand after two seconds."""
        return self.fault == "jam_finger"

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
    return cases + [Case("jam_finger", stage, "thumb") for stage in ("pre_grasp", "close", "release")]


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

    def problems(self, limit: float) -> list[str]:
        """What is not as it must be; `limit` [s] is the time for answer and end state."""
        if not self.reached:
            return ["stage not reached"]
        found = []
        if self.code not in self.case.codes:
            found.append(f"code {self.code}")
        if not self.case.moves_on:
            if self.answered is None or self.answered > limit:
                found.append(f"answered after {self.answered} s")
            if self.settled is None or self.settled > limit:
                found.append(f"end state after {self.settled} s")
            if not self.stood:
                found.append("the arm moved afterwards")
        if not self.truthful:
            found.append("untrue about the object")
        if self.home != 0:
            found.append(f"/go_home answered {self.home}")
        if self.next_pick not in _PICKED:
            found.append(f"next pick ended with {self.next_pick} {self.next_message}")
        return found


def table(outcomes: Iterable[Outcome], limit: float) -> list[dict[str, object]]:
    """Rows by fault: trials, how many were right, slowest answer and end state, what went wrong."""
    rows: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        rows.setdefault(outcome.case.name, []).append(outcome)
    return [
        {
            "fault": name,
            "stages": sorted({o.case.stage for o in group}, key=STAGES.index),
            "trials": len(group),
            "right": sum(not o.problems(limit) for o in group),
            "slowest_answer_s": _largest(o.answered for o in group),
            "slowest_end_state_s": _largest(o.settled for o in group),
            "problems": [f"{o.case.stage}: {', '.join(p)}" for o in group if (p := o.problems(limit))],
        }
        for name, group in rows.items()
    ]


def document_table(report: Mapping[str, Any]) -> str:
    """Markdown of what `python -m dgs_bringup.faults --json` writes."""
    lines = [
        "| fault | at | trials | right | slowest answer, end state [s, simulated] | not right |",
        "|---|---|---|---|---|---|",
    ]
    for row in report["faults"]:
        seconds = ", ".join("–" if row[key] is None else f"{row[key]:.2f}" for key in _SLOWEST)
        wrong = "; ".join(row["problems"]) or "–"
        stages = ", ".join(row["stages"])
        lines.append(
            f"| {row['fault']} | {stages} | {row['trials']} | {row['right']} | {seconds} | {wrong} |"
        )
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


def _largest(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(max(known), 3) if known else None
