"""The protocol that clears a table (section VI of the paper): what to try next, what to give up, when to stop. No ROS.

The paper executes the best-scored grasp, re-captures after every attempt and gives an object up after three failures.
A robot without object tracking knows places instead of objects: failures within `place_radius` of one another count as
the same object, and the place moves along when the object was pushed. A push counts there like a failure, for
the object is not gone, but it is no grasp.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from dgs_description.errors import ErrorCode
from dgs_description.failed_grasps import FailedGrasps
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.parameters import parameter
from dgs_description.words import plural

MAX_CANDIDATES = 32
"""Grasps that are offered to the arm at once: as many as it plans for in a second or two."""

# What the planner answers when there is nothing wrong with it.
_CLOUD_CODES = {
    ErrorCode.CLOUD_EMPTY,
    ErrorCode.CLOUD_NOT_FINITE,
    ErrorCode.CLOUD_FRAME_UNKNOWN,
    ErrorCode.CLOUD_FORMAT,
    ErrorCode.CLOUD_NO_TABLE,
    ErrorCode.NO_CLOUD_YET,
    ErrorCode.CLOUD_STALE,
}
# The arm's own words for the same.
_OBSTACLE_CODES = {ErrorCode.OBSTACLES_MISSING, ErrorCode.OBSTACLES_STALE}
_STOP_CODES = {ErrorCode.STOPPED, ErrorCode.PROTECTIVE_STOP}
_INFEASIBLE_CODES = {ErrorCode.NO_CANDIDATES, ErrorCode.NO_FEASIBLE_GRASP, ErrorCode.NO_PATH}
# The grasp was tried and did not work: the normal way to fail.
_MISSED_CODES = {ErrorCode.NOTHING_HELD, ErrorCode.LOST_OBJECT, ErrorCode.FORCE_LIMIT}
# The attempt was given up; another plan may work the next time, but not for ever. Infeasible ones: no way home.
_FAULT_CODES = _INFEASIBLE_CODES | {
    ErrorCode.TRAJECTORY_ABORTED,
    ErrorCode.TRAJECTORY_REJECTED,
    ErrorCode.SAFETY_ENVELOPE,
    ErrorCode.HAND_BLOCKED,
    ErrorCode.HAND_TIMEOUT,
    ErrorCode.HAND_BUSY,
    ErrorCode.HAND_CANCELLED,
}


@dataclass(frozen=True)
class ClearTableParameters:
    """Parameters of the task node, those of the protocol first."""

    max_attempts: int = parameter(30, "Executed grasps and pushes per run if the goal says 0.", 1)
    failures_per_place: int = parameter(
        3,
        "Failed grasps after which a place is given up; after twice as many pushes nothing is pushed there.",
        1,
    )
    place_radius: float = parameter(0.06, "Failures this close belong to one place [m].", 0.001)
    idle_rounds: int = parameter(3, "Looks in a row without a feasible grasp that end the run.", 1)
    max_faults: int = parameter(3, "Failed motions of arm or hand in a row that end the run.", 1)
    min_score: float = parameter(
        0.0, "Least score that a grasp's proposer gives, before the ranking; 0 = the planner's.", 0.0, 1.0
    )
    overlap: bool = parameter(True, "Look for the next grasp and plan it while the arm is on its last way.")
    settle_time: float = parameter(0.5, "Wait after the arm is home before a cloud counts [s].", 0.0)
    server_timeout: float = parameter(
        10.0, "Wait for planner and arm executor to appear, for the arm to take or to end a goal [s].", 0.1
    )
    restart_timeout: float = parameter(30.0, "Wait for a planner that went to come back [s].", 0.1)
    cloud_timeout: float = parameter(20.0, "Wait for a fresh cloud [s].", 0.1)
    predict_timeout: float = parameter(60.0, "Wait for /predict_grasps [s].", 0.1)
    execute_timeout: float = parameter(300.0, "Wait for /execute_grasp or /go_home [s].", 1.0)
    cloud_topic: str = parameter("/dgs/cloud", "Clouds of the camera node.")
    autostart: bool = parameter(False, "Start one run as soon as planner and arm are there.")
    seed: int = parameter(0, "Seed of the run started by autostart.", 0)


@dataclass(frozen=True)
class Place:
    """Where grasps failed or something was pushed to."""

    position: Array
    """(3,) reference point of the last failed grasp there, or where it was pushed to [m]."""
    failures: int = 0
    pushes: int = 0


@dataclass(frozen=True)
class Record:
    """One executed grasp: its number from 1, what the arm answered, whether the object lies in the bin."""

    attempt: int
    grasp: GraspSet
    code: int
    message: str
    success: bool
    stage_times: dict[str, float]
    """How long each stage of this attempt took [s]."""


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
        message: one sentence for the feedback or the result.
        indices: for EXECUTE, which candidates to offer, best first.
        code: for END, the error code of the run.
    """

    next: Next
    message: str
    indices: tuple[int, ...] = ()
    code: ErrorCode = ErrorCode.SUCCESS


class ClearTable:
    """State of one run; every answer of planner or arm goes in and the next step comes out.

    Attributes:
        records: one per executed grasp.
        pushes: how many were executed.
        places: where grasps failed so far.
        failed: the grasps that did.
    """

    def __init__(self, settings: ClearTableParameters, seed: int) -> None:
        """Start a run; `seed` fixes the seeds of all predictions."""
        self.settings = settings
        self.records: list[Record] = []
        self.pushes = 0
        self.places: list[Place] = []
        self.failed = FailedGrasps()
        self._seeds = np.random.SeedSequence(seed)
        self._candidates = GraspSet.empty()
        self._queue: list[int] = []
        self._idle = 0
        self._faults = 0
        self._last_place: Place | None = None

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
        """Places with as many failures or pushes as the protocol allows."""
        most = self.settings.failures_per_place
        return [place for place in self.places if max(place.failures, place.pushes // 2) >= most]

    def next_seed(self) -> int:
        """A new seed in [0, 2^63) for the next prediction: a repeated look must not repeat a bad answer."""
        return int(self._seeds.spawn(1)[0].generate_state(1, np.uint64)[0] >> np.uint64(1))

    def after_prediction(self, code: int, message: str, candidates: GraspSet) -> Step:
        """EXECUTE with the candidates (best first) outside all given-up places, CAPTURE to look again, or END."""
        if code == ErrorCode.NO_OBJECTS:
            return self._end("the table is empty")
        if code in _CLOUD_CODES:
            return _failed(ErrorCode.TASK_NO_CLOUD, f"the planner has no usable cloud: {message}")
        last_look = self._idle + 1 >= self.settings.idle_rounds
        if code == ErrorCode.NO_GRASP or (code == ErrorCode.PLANNER_BUSY and not last_look):
            return self._idle_round(message)
        if code != ErrorCode.SUCCESS:
            return _failed(ErrorCode.TASK_PLANNER_FAILED, f"the planner failed ({int(code)}): {message}")
        self._candidates = candidates
        self._queue = self._outside_given_up(candidates)
        if not self._queue:
            found = plural(len(candidates), "grasp")
            return self._idle_round(f"{found}, only at places that were given up")
        best = candidates.score[self._queue[0]]
        return self._offer(f"{plural(len(self._queue), 'grasp')}, best score {best:.2f}")

    def if_it_succeeds(self, executed: int) -> ClearTable:
        """The run as it will be if the attempt under way, with that candidate, succeeds."""
        foreseen = deepcopy(self)
        foreseen.after_execution(ErrorCode.SUCCESS, "", executed)
        return foreseen

    @property
    def on_the_last_attempt(self) -> bool:
        """Whether the attempt under way is the last one that is allowed."""
        return self.attempts + self.pushes + 1 >= self.settings.max_attempts

    def after_execution(
        self,
        code: int,
        message: str,
        executed: int,
        stage_times: dict[str, float] | None = None,
        placed: bool = False,
    ) -> Step:
        """Record an answer of the arm and decide what to do next.

        Args:
            executed: index into the candidates of the grasp that the arm moved to; -1 = it did not move.
            stage_times: how long each stage of this attempt took [s].
            placed: whether the object lies in the bin although something failed later.

        Returns:
            CAPTURE or END; EXECUTE with the next candidates if the arm could reach none and there are more.
        """
        moved = executed >= 0
        if moved:
            grasp, success = self._candidates[executed], placed or code == ErrorCode.SUCCESS
            number, times = self.attempts + 1, stage_times or {}
            self.failed.note(grasp, success)
            if grasp.holds:
                self.records.append(Record(number, grasp, int(code), message, success, times))
                self._remember(grasp.reference_point, failures=not success, forget=success)
            else:
                self.pushes += 1
                if success:
                    self._remember(grasp.reference_point, grasp.motion, pushes=1)
                else:  # what ended early has not gone far, and is given up sooner
                    self._remember(grasp.reference_point, pushes=2)
        if code in _STOP_CODES:
            return _stopped(code, message)
        if code in _OBSTACLE_CODES:
            return _failed(ErrorCode.TASK_NO_CLOUD, f"the arm has no usable cloud: {message}")
        if code in _INFEASIBLE_CODES and not moved:
            following = f"the next candidates: {message}"
            return self._offer(following) if self._queue else self._idle_round(message)
        if code == ErrorCode.SCENE_CHANGED:
            return Step(Next.CAPTURE, message)
        if code not in _MISSED_CODES | _FAULT_CODES | {ErrorCode.SUCCESS}:
            return _arm_failed(code, message)
        self._idle = 0
        self._faults = self._faults + 1 if code in _FAULT_CODES else 0
        if self._faults >= self.settings.max_faults:
            return _arm_failed(code, message)
        if self.attempts + self.pushes >= self.settings.max_attempts:
            allowed = self.settings.max_attempts
            used_up = f"all {allowed} attempts are used up" if allowed > 1 else "the one attempt is used up"
            return _failed(ErrorCode.TASK_ATTEMPTS_USED_UP, used_up)
        return Step(Next.CAPTURE, message)

    def after_homing(self, code: int, message: str, released: bool) -> Step | None:
        """Note how the arm came home: before a look, unless it is out of the camera's way already, and in the end.

        Args:
            released: whether it let an object go into the bin that a failed attempt had left in the hand.

        Returns:
            END if the arm is not at home, else None.
        """
        if released and self.records:
            last = self.records[-1]
            sentence = f"{last.message}; brought to the bin afterwards"
            self.records[-1] = replace(last, success=True, message=sentence)
            self.failed.note(last.grasp, success=True)
            self.places = [place for place in self.places if place is not self._last_place]
        if code in _STOP_CODES:
            return _stopped(code, message)
        return None if code == ErrorCode.SUCCESS else _arm_failed(code, message)

    def summary(self) -> str:
        """One sentence about the run so far."""
        pushes = f", {plural(self.pushes, 'push')}" if self.pushes else ""
        given_up = f", {plural(len(self.given_up), 'place')} given up" if self.given_up else ""
        return f"{self.successes} of {plural(self.attempts, 'grasp')} succeeded{pushes}{given_up}"

    def _outside_given_up(self, candidates: GraspSet) -> list[int]:
        allowed = np.ones(len(candidates), dtype=bool)
        for place in self.given_up:
            away = np.linalg.norm(candidates.reference_point - place.position, axis=1)
            only_pushed = place.failures < self.settings.failures_per_place
            allowed &= (away > self.settings.place_radius) | (candidates.holds & only_pushed)
        return np.flatnonzero(allowed).tolist()

    def _offer(self, message: str) -> Step:
        offered, self._queue = self._queue[:MAX_CANDIDATES], self._queue[MAX_CANDIDATES:]
        return Step(Next.EXECUTE, message, indices=tuple(offered))

    def _remember(
        self, at: Array, moved: Array | float = 0.0, failures: int = 0, pushes: int = 0, forget: bool = False
    ) -> None:
        """Count at the known place nearest to `at` (3,), which was `moved` (3,) away [m]; or forget it."""

        def distance(place: Place) -> float:
            return float(np.linalg.norm(place.position - at))

        near = [place for place in self.places if distance(place) <= self.settings.place_radius]
        nearest = min(near, key=distance, default=None)
        self.places = [place for place in self.places if place is not nearest]
        if not forget:
            known = nearest or Place(at)
            self._last_place = Place(at + moved, known.failures + failures, known.pushes + pushes)
            self.places.append(self._last_place)

    def _idle_round(self, why: str) -> Step:
        self._idle += 1
        if self._idle < self.settings.idle_rounds:
            return Step(Next.CAPTURE, f"looking again: {why}")
        return self._end(f"nothing graspable is left after {plural(self._idle, 'look')}: {why}")

    def _end(self, why: str) -> Step:
        return Step(Next.END, f"{why}; {self.summary()}")


def _failed(code: ErrorCode, message: str) -> Step:
    return Step(Next.END, message, code=code)


def _stopped(code: int, message: str) -> Step:
    return _failed(ErrorCode.TASK_STOPPED, f"the robot was stopped ({int(code)}): {message}")


def _arm_failed(code: int, message: str) -> Step:
    return _failed(ErrorCode.TASK_ARM_FAILED, f"arm or hand failed ({int(code)}): {message}")
