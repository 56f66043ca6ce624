"""Chooses grasp and arm motion together: the best grasp whose whole pick is free, rather one without a detour."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dgs_arm_executor.cartesian import CartesianLine, track_line
from dgs_arm_executor.ik import ArmIK
from dgs_arm_executor.paths import plan_path
from dgs_arm_executor.pick_candidate import FAR, Candidate, PickLines
from dgs_arm_executor.pick_checkers import PickCheckers
from dgs_arm_executor.pick_plan import PickAnswer, PickPlan, PickSettings, Rejection
from dgs_arm_executor.planning_scene import CollisionChecker, PlanningScene, SceneSettings
from dgs_arm_executor.release import release_states
from dgs_arm_executor.situation import ArmSituation
from dgs_arm_executor.timing import Trajectory, time_path
from dgs_arm_executor.tool_way import least_times, time_free_path
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND

LOOK_AHEAD, SAME_SCORE = 4, 0.05
"""Of so many grasps in a row whose scores hardly differ one without a detour is looked for: detours took 6 s more."""
_BIN_TRIES = 6
"""So many states over the bin are tried on the way home with an object."""
_SEARCHED = 4
"""To so many states over the bin ways are searched where no straight one is free: they differ by half."""


_Way = dict[str, Trajectory]
"""Trajectory by stage."""
_Plan = Callable[[Candidate, bool], _Way | None]
"""The whole pick, or only to the end of the lift."""


@dataclass
class PickPlanner:
    """Plans whole picks for one cell."""

    ik: ArmIK = field(default_factory=ArmIK)
    settings: PickSettings = field(default_factory=PickSettings)
    scene_settings: SceneSettings = field(default_factory=SceneSettings)

    @property
    def home(self) -> Array:
        """(6,) home posture [rad]."""
        return np.array(self.settings.home)

    def plan(self, situation: ArmSituation, grasps: GraspSet, keep_holding: bool = False) -> PickAnswer:
        """Plan start, stand-off, grasp, lift, bin and home for the best grasp that allows all of it.

        Of up to `LOOK_AHEAD` grasps whose scores are much the same the first wins that is had on straight joint lines;
        where none is, detours are searched, first for the one that is nearest.

        Args:
            situation: where the arm starts; what the hand holds falls out of it before the pick.
            grasps: in `base_link`, in order of preference.
            keep_holding: stop after the lift.

        Raises:
            DgsError: NO_CANDIDATES; NO_PATH if the arm starts inside itself or the cell.
        """
        end = time.perf_counter() + self.settings.planning_time
        if not len(grasps):
            raise DgsError(ErrorCode.NO_CANDIDATES, "the goal holds no grasps")
        scene, escape, start = self._set_out(situation)
        refused: dict[int, DgsError] = {}
        for equals in _much_the_same(grasps):
            candidates = [
                Candidate(self.ik, self.settings, scene, start, situation.hand_joints, index, grasps[index])
                for index in equals
            ]
            for plan_way, candidate in self._turns(candidates):
                if candidate.index in refused:
                    continue
                try:
                    if time.perf_counter() > end:
                        left_out = (
                            "not looked at" if plan_way == self._directly else "no detour was looked for"
                        )
                        limit = f"the planning time of {self.settings.planning_time:g} s"
                        raise DgsError(ErrorCode.NO_PATH, f"{left_out}: {limit} is used up")
                    way = plan_way(candidate, keep_holding)
                except DgsError as error:
                    refused[candidate.index] = error
                    continue
                if way is None:
                    continue
                transfer, checkers = way["transfer"].positions, candidate.checkers
                shaping = all(checker.first_collision(transfer) is None for checker in checkers.shaping)
                refused = {other.index: other.refusal() for other in candidates} | refused
                whole = dict(zip(["escape"], escape, strict=False)) | way
                plan = PickPlan(candidate.index, checkers.load, whole, shaping)
                return PickAnswer(plan, _rejections(refused, candidate.index))
        return PickAnswer(None, _rejections(refused, len(grasps)))

    def plan_off(self, arm_joints: ArrayLike, plan: PickPlan, stage: str) -> Trajectory:
        """Retreat or lift of a plan from the measured state: what fingers meet may have pushed the arm off its pose.

        Straight to where the planned stage ends, so that what follows it fits. Raises DgsError as `track_line`.
        """
        q, settings = np.asarray(arm_joints, float), self.settings
        line = track_line(self.ik, self.ik.tcp(q), self.ik.tcp(plan.trajectories[stage].end), q)
        return self._time_line(line, settings.lift_speed if stage == "lift" else settings.advance_speed)

    def plan_shift(self, arm_joints: ArrayLike, shift: Array, pushing: bool = False) -> Trajectory:
        """Straight by (3,) [m] from (6,) joints [rad], as fast as a push or a lift. Raises DgsError as `track_line`."""
        q, settings = np.asarray(arm_joints, float), self.settings
        T_base_tcp = self.ik.tcp(q)
        line = track_line(self.ik, T_base_tcp, transform(position=shift) @ T_base_tcp, q)
        return self._time_line(line, settings.advance_speed if pushing else settings.lift_speed)

    def distance(self, one: ArrayLike, other: ArrayLike) -> float:
        """Between the TCP's places in two postures (6,) [m]."""
        return float(np.linalg.norm(self.ik.tcp(one)[:3, 3] - self.ik.tcp(other)[:3, 3]))

    def plan_home(self, situation: ArmSituation) -> list[Trajectory]:
        """Trajectories home, with the hand as it is and what it holds. Raises DgsError NO_PATH."""
        return self._plan_way(situation, self.home, self.settings.speed)

    def plan_to_bin(self, situation: ArmSituation) -> list[Trajectory]:
        """Trajectories to the first posture over the bin that what is held can reach. Raises DgsError NO_PATH."""
        box = None if situation.load is None else situation.load.box
        last = DgsError(ErrorCode.NO_PATH, "no posture over the bin is within reach")
        for posture in release_states(self.ik, box, situation.arm_joints, self.settings)[:_BIN_TRIES]:
            try:
                return self._plan_way(situation, posture, self.settings.carry_speed)
            except DgsError as error:
                last = error
        raise last

    def opened(self, situation: ArmSituation, otherwise: Array) -> Array:
        """(J,) the open hand, or `otherwise` where it would meet arm or cell as they stand [rad]."""
        scene = PlanningScene(situation.cloud, self.scene_settings)
        whole = scene.checker(HAND.open_hand, use_cloud=False, hand_on_table=True)
        return otherwise if whole.in_collision(situation.arm_joints) else HAND.open_hand

    # one grasp

    def _turns(self, candidates: list[Candidate]) -> Iterator[tuple[_Plan, Candidate]]:
        """How to plan which candidate: what goes directly in their order, then detours where the way is short."""
        yield from ((self._directly, candidate) for candidate in candidates)
        yield from ((self._with_detours, candidate) for candidate in sorted(candidates, key=Candidate.way))

    def _directly(self, candidate: Candidate, keep_holding: bool) -> _Way | None:
        """On straight joint lines between near postures, or None."""
        lines = candidate.lines(far=False)
        return _first(self._connect(candidate, each, keep_holding, near=True) for each in lines)

    def _with_detours(self, candidate: Candidate, keep_holding: bool) -> _Way:
        """With the sampling planner, between near postures first, and to any state over the bin."""
        everywhere = [*candidate.free[False], *candidate.lines(far=True)]
        if not everywhere:
            raise candidate.refusal()
        goals, search = self.settings.sampled_goals, self.settings.path_time
        way = _first(
            self._connect(candidate, lines, keep_holding, search if k < goals else 0.0)
            for k, lines in enumerate(everywhere)
        )
        if way is None:
            sentence = "no collision-free path to the stand-off or from the lift to the bin was found"
            raise DgsError(ErrorCode.NO_PATH, sentence)
        return way

    def _connect(
        self,
        candidate: Candidate,
        lines: PickLines,
        keep_holding: bool,
        search: float = 0.0,
        near: bool = False,
    ) -> _Way | None:
        """Trajectories of all stages, or None where the lines cannot be reached or left.

        Args:
            search: how long to search for each of the paths between the lines [s]; 0 = straight or nothing.
            near: only release states near the lift's end will do.
        """
        settings, checkers = self.settings, candidate.checkers
        lifted = lines.lift.joints[-1]
        transfer = plan_path(checkers.transfer, candidate.start, lines.approach.joints[0], search)
        if transfer is None:
            return None
        out = {
            "transfer": time_free_path(self.ik, transfer, settings.speed),
            "approach": self._time_line(lines.approach, settings.approach_speed),
        }
        if lines.advance is not None:
            out["advance"] = self._time_line(lines.advance, settings.advance_speed)
        if lines.retreat is not None:
            out["retreat"] = self._time_line(lines.retreat, settings.advance_speed)
        out["lift"] = self._time_line(lines.lift, settings.lift_speed)
        if not checkers.load.grasp.holds:
            home = plan_path(checkers.home, lifted, self.home, search)
            return None if home is None else out | {"home": time_free_path(self.ik, home, settings.speed)}
        if keep_holding:
            return out
        carry_home = self._to_bin(checkers, lifted, search, near)
        return None if carry_home is None else out | carry_home

    def _to_bin(self, checkers: PickCheckers, lifted: Array, search: float, near: bool) -> _Way | None:
        """Over the bin and home: straight to the nearest state that allows it, else the shortest way of a few."""
        settings = self.settings
        states = release_states(self.ik, checkers.load.box, lifted, settings)[: settings.release_tries]
        if not len(states):
            return None
        ways = least_times(self.ik, lifted, states)
        order = np.argsort(ways, kind="stable")
        states = states[[k for k in order if not near or ways[k] < ways.min() + FAR]]

        def way(release: Array, carry_search: float) -> _Way | None:
            carry = plan_path(checkers.carry, lifted, release, carry_search)
            home = None if carry is None else plan_path(checkers.home, release, self.home, search)
            if carry is None or home is None:
                return None
            return {
                "carry": time_free_path(self.ik, carry, settings.carry_speed),
                "home": time_free_path(self.ik, home, settings.speed),
            }

        found = _first(way(release, 0.0) for release in states)
        if found is not None or not search:
            return found
        free = (q for q in states if not checkers.carry.in_collision(q) and not checkers.home.in_collision(q))
        searched = [way(release, search) for release in islice(free, _SEARCHED)]
        return min(filter(None, searched), key=lambda one: one["carry"].duration, default=None)

    def _time_line(self, line: CartesianLine, tcp_speed: float) -> Trajectory:
        return time_path(line.smooth(), self.settings.speed, max_path_speed=tcp_speed)

    # the start

    def _plan_way(self, situation: ArmSituation, goal: Array, speed: float) -> list[Trajectory]:
        """Trajectories to (6,) joints with the hand as it is and what it holds. Raises DgsError NO_PATH."""
        shape: dict[str, Any] = {}
        box = None if situation.load is None else situation.load.box
        if box is not None:
            held = box.holds(situation.cloud.points, self.ik.tcp(situation.arm_joints))
            shape = {"released": held, "carried": box}
        scene, escape, start = self._set_out(situation, **shape)
        checker = scene.checker(situation.hand_joints, **shape)
        path = plan_path(checker, start, goal, self.settings.path_time)
        if path is None:
            ends = (("starts", start), ("would end", goal))
            bad = [f"it {end} where {checker.describe(q)}" for end, q in ends if checker.in_collision(q)]
            why = " and ".join(bad) or f"its search ended after {self.settings.path_time:g} s"
            raise DgsError(ErrorCode.NO_PATH, f"no collision-free path home or to the bin was found: {why}")
        return [*escape, time_free_path(self.ik, path, speed)]

    def _set_out(
        self, situation: ArmSituation, **shape: Any
    ) -> tuple[PlanningScene, list[Trajectory], Array]:
        """The scene, a short straight way out of the observed cloud where the arm is in it, (6,) joints at its end.

        The scene goes without a clearance (cell and itself, cloud) that the robot does not keep at the start. After a
        stop in the middle of a grasp the fingers are around the object, and what the hand holds may still stand on the
        table, so that every path would start in collision.

        `shape` is what is carried, as `PlanningScene.checker` takes it.
        """
        settings, start, hand = self.scene_settings, situation.arm_joints, situation.hand_joints
        scene = PlanningScene(situation.cloud, settings)
        clearance = settings.transfer_clearance
        if not scene.checker(hand, cloud_clearance=clearance, **shape).in_collision(start):
            return scene, [], start
        lenient = {"hand_on_table": True, **shape}
        if scene.checker(hand, use_cloud=False, **lenient).in_collision(start):
            settings = replace(settings, arm_clearance=0.0)
            scene = PlanningScene(situation.cloud, settings)
        if scene.checker(hand, cloud_clearance=clearance, **lenient).in_collision(start):
            settings = replace(settings, transfer_clearance=0.0)
            scene = PlanningScene(situation.cloud, settings)
        whole = scene.checker(hand, **shape)
        if not whole.in_collision(start):
            return scene, [], start
        without_cloud = scene.checker(hand, use_cloud=False, hand_on_table=True, **shape)
        line = self._way_out(start, whole, without_cloud, carrying="carried" in shape)
        return scene, [self._time_line(line, self.settings.lift_speed)], line.joints[-1]

    def _way_out(
        self, start: Array, whole: CollisionChecker, without_cloud: CollisionChecker, carrying: bool
    ) -> CartesianLine:
        """Straight back or up from (6,) joints [rad], through nothing but the cloud, to where all is free."""
        if without_cloud.in_collision(start):
            touching = without_cloud.describe(start)
            sentence = f"the arm starts in collision ({touching}): move it free by hand first"
            raise DgsError(ErrorCode.NO_PATH, sentence)
        T_start = self.ik.tcp(start)
        back, up = self.settings.backed_off, self.settings.lifted
        ways = [back(T_start), up(T_start), up(back(T_start))]
        for T_end in ways[1:] if carrying else ways:
            try:
                line = track_line(self.ik, T_start, T_end, start)
            except DgsError:
                continue
            if without_cloud.first_collision(line.joints) is None and not whole.in_collision(line.joints[-1]):
                return line
        inside = f"the arm starts inside the observed cloud ({whole.describe(start)})"
        raise DgsError(ErrorCode.NO_PATH, f"{inside} and no straight way out is free")


def _first(ways: Iterable[_Way | None]) -> _Way | None:
    """The first that was found."""
    return next((way for way in ways if way is not None), None)


def _much_the_same(grasps: GraspSet) -> Iterator[range]:
    """Indices of grasps in a row with hardly other scores that all hold, or all push; `LOOK_AHEAD` at most."""
    first, score, holds = 0, grasps.score, grasps.holds
    for index in range(1, len(score) + 1):
        if (
            index in (len(score), first + LOOK_AHEAD)
            or abs(score[index] - score[first]) > SAME_SCORE
            or holds[index] != holds[first]
        ):
            yield range(first, index)
            first = index


def _rejections(refused: dict[int, DgsError], chosen: int) -> tuple[Rejection, ...]:
    """Why those before the chosen one were not taken."""
    return tuple(Rejection(k, refused[k].code, refused[k].message) for k in sorted(refused) if k < chosen)
