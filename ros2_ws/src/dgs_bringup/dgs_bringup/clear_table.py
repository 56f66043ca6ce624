"""The protocol that clears a table (section VI of the paper): what to try next, what to give up, when to stop. No ROS.

The paper executes the best-scored grasp, re-captures after every attempt and gives an object up after three failures.
A robot without object tracking knows places instead of objects: failures within `place_radius` of one another count as
the same object, and the place moves along when the object was pushed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import ErrorCode
from dgs_description.grasp import GraspSet

Array = NDArray[np.float64]

# What the planner answers when there is nothing wrong with it.
_CLOUD_CODES = frozenset(
    {
        ErrorCode.CLOUD_EMPTY,
        ErrorCode.CLOUD_NOT_FINITE,
        ErrorCode.CLOUD_FRAME_UNKNOWN,
        ErrorCode.CLOUD_FORMAT,
        ErrorCode.NO_CLOUD_YET,
        ErrorCode.CLOUD_STALE,
    }
)
# The arm's own words for the same.
_OBSTACLE_CODES = frozenset({ErrorCode.OBSTACLES_MISSING, ErrorCode.OBSTACLES_STALE})
_STOP_CODES = frozenset({ErrorCode.STOPPED, ErrorCode.PROTECTIVE_STOP})
_INFEASIBLE_CODES = frozenset({ErrorCode.NO_CANDIDATES, ErrorCode.NO_FEASIBLE_GRASP, ErrorCode.NO_PATH})
# The grasp was tried and did not work: the normal way to fail.
_MISSED_CODES = frozenset({ErrorCode.NOTHING_HELD, ErrorCode.LOST_OBJECT})
# The attempt was given up; another plan may work the next time, but not for ever.
_FAULT_CODES = frozenset(
    {
        ErrorCode.TRAJECTORY_ABORTED,
        ErrorCode.TRAJECTORY_REJECTED,
        ErrorCode.SAFETY_ENVELOPE,
        ErrorCode.HAND_BLOCKED,
        ErrorCode.HAND_TIMEOUT,
        ErrorCode.HAND_BUSY,
        ErrorCode.HAND_CANCELLED,
    }
)


@dataclass(frozen=True)
class Rules:
    """Numbers of the protocol.

    Raises:
        ValueError: a number is not positive.
    """

    max_attempts: int = 30
    """Grasps that may be executed in one run."""
    max_candidates: int = 32
    """Grasps that are offered to the arm at once."""
    failures_per_place: int = 3
    """Failed grasps after which a place is given up."""
    place_radius: float = 0.06
    """Reference points closer than this belong to one place [m]."""
    idle_rounds: int = 3
    """Predictions in a row without an executable grasp after which the run ends."""
    max_faults: int = 3
    """Faults of arm or hand in a row after which the run ends."""

    def __post_init__(self) -> None:
        """Refuse numbers that make no sense."""
        for name, value in vars(self).items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value!r}")


@dataclass(frozen=True)
class Place:
    """Where grasps failed."""

    position: Array
    """(3,) reference point of the last failed grasp there [m]."""
    failures: int


@dataclass(frozen=True)
class Record:
    """One executed grasp."""

    attempt: int
    score: float
    T_base_tcp: Array
    """(4, 4) where the hand closed [m]."""
    code: int
    message: str
    success: bool
    stage_times: dict[str, float] = field(default_factory=dict)
    source: str = ""
    """Proposer of the grasp."""


class Next(Enum):
    """What the task does next."""

    EXECUTE = "execute"
    CAPTURE = "capture"
    END = "end"


@dataclass(frozen=True)
class Step:
    """Decision after an answer of the planner or the arm.

    Attributes:
        next: what to do.
        indices: for EXECUTE, which candidates to offer, best first.
        code: for END, the error code of the run.
        message: one sentence for the feedback or the result.
    """

    next: Next
    message: str
    indices: tuple[int, ...] = ()
    code: ErrorCode = ErrorCode.SUCCESS


class ClearTable:
    """State of one run; every answer of planner or arm goes in and the next step comes out.

    Attributes:
        records: one per executed grasp.
        places: where grasps failed so far.
    """

    def __init__(self, rules: Rules, seed: int) -> None:
        """Start a run; `seed` fixes the seeds of all predictions."""
        self.rules = rules
        self.records: list[Record] = []
        self.places: list[Place] = []
        self._seeds = np.random.SeedSequence(seed)
        self._queue: list[int] = []
        self._idle = 0
        self._faults = 0
        self._last_position = np.zeros(3)

    @property
    def attempts(self) -> int:
        """Grasps executed so far."""
        return len(self.records)

    @property
    def successes(self) -> int:
        """Grasps whose object was lifted and placed."""
        return sum(record.success for record in self.records)

    @property
    def given_up(self) -> list[Place]:
        """Places with as many failures as the protocol allows."""
        return [place for place in self.places if place.failures >= self.rules.failures_per_place]

    def next_seed(self) -> int:
        """A new seed in [0, 2^63) for the next prediction: a repeated look must not repeat a bad answer."""
        return int(self._seeds.spawn(1)[0].generate_state(1, np.uint64)[0] >> np.uint64(1))

    def after_prediction(self, code: int, message: str, candidates: GraspSet) -> Step:
        """Decide what to do with an answer of the planner.

        Args:
            code: its error code.
            message: its sentence.
            candidates: the predicted grasps, best first; only read if `code` is 0.

        Returns:
            EXECUTE with the candidates outside all given-up places, CAPTURE to look again, or END.
        """
        if code == ErrorCode.NO_OBJECTS:
            return self._end("the table is empty")
        if code in _CLOUD_CODES:
            return Step(Next.END, f"the planner has no usable cloud: {message}", code=ErrorCode.TASK_NO_CLOUD)
        if code in (ErrorCode.NO_GRASP, ErrorCode.PLANNER_BUSY):
            return self._idle_round(message)
        if code != ErrorCode.SUCCESS:
            return Step(
                Next.END, f"the planner failed ({int(code)}): {message}", code=ErrorCode.TASK_PLANNER_FAILED
            )
        self._queue = self._outside_given_up(candidates)
        if not self._queue:
            return self._idle_round(f"all {len(candidates.score)} grasps are at places that were given up")
        best = candidates.score[self._queue[0]]
        return self._offer(f"{len(self._queue)} grasps, best score {best:.2f}")

    def after_execution(
        self,
        code: int,
        message: str,
        executed: int,
        candidates: GraspSet,
        stage_times: dict[str, float] | None = None,
        placed: bool = False,
    ) -> Step:
        """Record an answer of the arm and decide what to do next.

        Args:
            code: its error code.
            message: its sentence.
            executed: index into `candidates` of the grasp that the arm moved to; -1 = it did not move.
            candidates: the prediction that the grasp came from.
            stage_times: how long each stage of this attempt took [s].
            placed: whether the object lies in the bin although something failed later.

        Returns:
            CAPTURE or END; EXECUTE with the next candidates if the arm could reach none and there are more.
        """
        if executed >= 0:
            placed = placed or code == ErrorCode.SUCCESS
            self._record(code, message, executed, candidates, stage_times or {}, placed)
        if code in _STOP_CODES:
            return Step(
                Next.END, f"the robot was stopped ({int(code)}): {message}", code=ErrorCode.TASK_STOPPED
            )
        if code in _OBSTACLE_CODES:
            return Step(Next.END, f"the arm has no usable cloud: {message}", code=ErrorCode.TASK_NO_CLOUD)
        moved = executed >= 0
        if code in _INFEASIBLE_CODES and not moved:
            return (
                self._offer(f"the next candidates: {message}") if self._queue else self._idle_round(message)
            )
        faults = _FAULT_CODES | _INFEASIBLE_CODES  # no way home after the grasp
        if code not in _MISSED_CODES | faults | {ErrorCode.SUCCESS}:
            return self._arm_failed(code, message)
        self._idle = 0
        self._faults = self._faults + 1 if code in faults else 0
        if self._faults >= self.rules.max_faults:
            return self._arm_failed(code, message)
        if self.attempts >= self.rules.max_attempts:
            return Step(
                Next.END,
                f"all {self.rules.max_attempts} attempts are used up",
                code=ErrorCode.TASK_ATTEMPTS_USED_UP,
            )
        return Step(Next.CAPTURE, message)

    def after_homing(self, code: int, message: str, released: bool) -> Step | None:
        """Note how the arm came home, which it does before every look.

        Args:
            code: error code of the arm.
            message: its sentence.
            released: whether it let an object go into the bin that a failed attempt had left in the hand.

        Returns:
            END if the arm is not at home, else None.
        """
        if released and self.records and not self.records[-1].success:
            last = self.records[-1]
            self.records[-1] = replace(
                last, success=True, message=f"{last.message}; brought to the bin afterwards"
            )
            self.places = [p for p in self.places if not np.array_equal(p.position, self._last_position)]
        if code in _STOP_CODES:
            return Step(
                Next.END, f"the robot was stopped ({int(code)}): {message}", code=ErrorCode.TASK_STOPPED
            )
        return None if code == ErrorCode.SUCCESS else self._arm_failed(code, message)

    def summary(self) -> str:
        """One sentence about the run so far."""
        given_up = f", {len(self.given_up)} places given up" if self.given_up else ""
        return f"{self.successes} of {self.attempts} grasps succeeded{given_up}"

    def _outside_given_up(self, candidates: GraspSet) -> list[int]:
        allowed = np.ones(len(candidates.score), dtype=bool)
        for place in self.given_up:
            distance = np.linalg.norm(candidates.reference_point - place.position, axis=1)
            allowed &= distance > self.rules.place_radius
        return np.flatnonzero(allowed).tolist()

    def _offer(self, message: str) -> Step:
        count = self.rules.max_candidates
        offered, self._queue = self._queue[:count], self._queue[count:]
        return Step(Next.EXECUTE, message, indices=tuple(offered))

    def _record(
        self,
        code: int,
        message: str,
        executed: int,
        candidates: GraspSet,
        times: dict[str, float],
        success: bool,
    ) -> None:
        self.records.append(
            Record(
                attempt=self.attempts + 1,
                score=float(candidates.score[executed]),
                T_base_tcp=candidates.pose[executed],
                code=int(code),
                message=message,
                success=success,
                stage_times=times,
                source=str(candidates.source[executed]),
            )
        )
        self._last_position = np.array(candidates.reference_point[executed], dtype=float)
        self._remember(self._last_position, success)

    def _remember(self, position: Array, success: bool) -> None:
        """Count a failure at the nearest known place, or forget the place if its object is gone."""
        near = [
            k
            for k, place in enumerate(self.places)
            if np.linalg.norm(place.position - position) <= self.rules.place_radius
        ]
        nearest = min(
            near, key=lambda k: float(np.linalg.norm(self.places[k].position - position)), default=None
        )
        failures = self.places.pop(nearest).failures if nearest is not None else 0
        if not success:
            self.places.append(Place(position, failures + 1))

    def _idle_round(self, why: str) -> Step:
        self._idle += 1
        if self._idle < self.rules.idle_rounds:
            return Step(Next.CAPTURE, f"looking again: {why}")
        return self._end(f"nothing graspable is left after {self._idle} looks: {why}")

    def _end(self, why: str) -> Step:
        return Step(Next.END, f"{why}; {self.summary()}")

    def _arm_failed(self, code: int, message: str) -> Step:
        return Step(Next.END, f"arm or hand failed ({int(code)}): {message}", code=ErrorCode.TASK_ARM_FAILED)
