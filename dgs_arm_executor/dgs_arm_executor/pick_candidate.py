"""One grasp as the pick planner looks at it: IK branches, and on each the lines that do not depend on the start."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dgs_arm_executor.cartesian import CartesianLine, track_line
from dgs_arm_executor.ik import T_TCP_TOOL0, ArmIK
from dgs_arm_executor.pick_checkers import PickCheckers, check_grasp
from dgs_arm_executor.pick_plan import PickSettings
from dgs_arm_executor.planning_scene import CLOUD, CollisionChecker, PlanningScene
from dgs_arm_executor.tool_way import least_times
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_description.grasp import GraspSet
from dgs_description.joints import ARM_UPPER
from dgs_description.pick import way_back

_CENTRE_WEIGHT, _DEXTERITY_WEIGHT = 0.05, 0.02
"""In the cost of a branch, against seconds of way: distance from the joints' middle, nearness to a singularity."""
FAR = 0.5
"""A posture that is so much farther at full speed than the nearest one takes longer than a detour to that [s]."""
_PROGRESS = (
    ErrorCode.OUT_OF_REACH,
    ErrorCode.JOINT_LIMIT,
    ErrorCode.IK_FAILED,
    ErrorCode.COLLISION_STAND_OFF,
    ErrorCode.COLLISION_APPROACH,
    ErrorCode.COLLISION_LIFT,
    ErrorCode.NO_PATH,
)
"""Reasons in the order in which a pick meets them: of several branches the one that came farthest is reported."""


class PickLines(NamedTuple):
    """The part of a pick that does not depend on where the arm starts: stand-off, grasp, its motion, back from what was
    pushed, lifted."""

    approach: CartesianLine
    advance: CartesianLine | None
    retreat: CartesianLine | None
    lift: CartesianLine


@dataclass
class Candidate:
    """One grasp as far as it has been looked at.

    Attributes:
        ik, settings, scene: of the planner.
        start: (6,) joints that the pick starts from [rad].
        hand_joints: (J,) of the hand there [rad].
        index: in the goal.
        grasp: in `base_link`.
        free: lines that were found free, on near IK branches and on far ones.
    """

    ik: ArmIK
    settings: PickSettings
    scene: PlanningScene
    start: Array
    hand_joints: Array
    index: int
    grasp: GraspSet
    free: tuple[list[PickLines], list[PickLines]] = field(init=False, default_factory=lambda: ([], []))
    _refused: list[DgsError] = field(init=False, default_factory=list)

    @cached_property
    def checkers(self) -> PickCheckers:
        """Of the situations it passes through. Raises DgsError GRASP_INVALID."""
        return PickCheckers(self.scene, check_grasp(self.grasp), self.hand_joints)

    @cached_property
    def _states(self) -> tuple[Array, Array]:
        """(K, 6) arm joints at the grasp on near and far branches, turned next to the start, cheapest first [rad].

        Raises:
            DgsError: GRASP_INVALID; OUT_OF_REACH, JOINT_LIMIT: there is none.
        """
        grasp = self.checkers.load.grasp
        states = self.ik.states(grasp.pose, self.start)
        if len(states):
            ways = least_times(self.ik, self.start, states)
            order = np.argsort(ways + _clumsiness(self.ik, states), kind="stable")
            states, far = states[order], (ways >= ways.min() + FAR)[order]
            return states[~far], states[far]
        x, y, z = grasp.position
        place = f"({x:.3f}, {y:.3f}, {z:.3f}) m"
        if np.isnan(self.ik.branches(grasp.pose @ T_TCP_TOOL0)).all():
            raise DgsError(ErrorCode.OUT_OF_REACH, f"the grasp at {place} is out of the arm's reach")
        raise DgsError(ErrorCode.JOINT_LIMIT, f"every solution for {place} is beyond a joint limit")

    def lines(self, far: bool) -> Iterator[PickLines]:
        """Free lines on the near or the far branches. Raises DgsError GRASP_INVALID, OUT_OF_REACH, JOINT_LIMIT."""
        for q in self._states[far]:
            try:
                found = pick_lines(self.ik, self.settings, q, self.checkers)
            except DgsError as error:
                self._refused.append(error)
                continue
            self.free[far].append(found)
            yield found

    def way(self) -> float:
        """Shortest time at full speed to the stand-off on a near branch that is free [s]; infinite without one."""
        starts = [lines.approach.joints[0] for lines in self.free[False]]
        return float(min(least_times(self.ik, self.start, np.array(starts)))) if starts else np.inf

    def refusal(self) -> DgsError:
        """Why it is not taken. A branch on which the arm would meet itself tells least."""
        if any(self.free) or not self._refused:
            return DgsError(ErrorCode.NO_PATH, "it needs a detour; a grasp that is as good has a shorter way")
        return max(self._refused, key=lambda error: (_PROGRESS.index(error.code), CLOUD in error.message))


def pick_lines(ik: ArmIK, settings: PickSettings, q: Array, checkers: PickCheckers) -> PickLines:
    """Approach to and lift from (6,) joints at the grasp, checked for collisions.

    Raises:
        DgsError: OUT_OF_REACH, IK_FAILED, JOINT_LIMIT, COLLISION_STAND_OFF, COLLISION_APPROACH, COLLISION_LIFT.
    """
    grasp, advance, retreat, closing = checkers.load.grasp, None, None, q
    T_base_closed = grasp.closing_pose
    if grasp.motion.any():
        advance = track_line(ik, grasp.pose, grasp.closing_pose, q)
        closing = advance.joints[-1]
        moving = checkers.lift if grasp.drags else checkers.approach
        _must_be_free(moving, advance.joints, ErrorCode.COLLISION_APPROACH, "on its motion")
    _must_be_free(checkers.lift, closing, ErrorCode.COLLISION_APPROACH, "with the hand closed")
    approach = track_line(ik, grasp.pose, settings.backed_off(grasp.pose), q).reversed()
    start = approach.joints[0]
    _must_be_free(checkers.transfer, start, ErrorCode.COLLISION_STAND_OFF, "at the stand-off")
    _must_be_free(checkers.approach, approach.joints, ErrorCode.COLLISION_APPROACH, "on the approach")
    try:
        if not grasp.holds and not grasp.drags:
            T_base_back = transform(position=way_back(grasp)) @ T_base_closed
            retreat = track_line(ik, T_base_closed, T_base_back, closing)
            T_base_closed, closing = T_base_back, retreat.joints[-1]
        lift = track_line(ik, T_base_closed, settings.lifted(T_base_closed), closing)
    except DgsError as error:
        raise DgsError(error.code, f"on the lift {error.message}") from error
    leaving = checkers.approach if grasp.drags else checkers.lift
    for line in filter(None, (retreat, lift)):
        _must_be_free(leaving, line.joints, ErrorCode.COLLISION_LIFT, "on the lift")
    return PickLines(approach, advance, retreat, lift)


def _clumsiness(ik: ArmIK, states: Array) -> Array:
    """(K,) small costs for joints far from their middle and for low dexterity, in seconds of way."""
    off_centre = ((states / ARM_UPPER) ** 2).sum(axis=1)
    clumsiness = np.array([1 / max(10 * ik.manipulability(q), 1e-3) for q in states])
    return np.asarray(_CENTRE_WEIGHT * off_centre + _DEXTERITY_WEIGHT * clumsiness)


def _must_be_free(checker: CollisionChecker, path: Array, code: ErrorCode, where: str) -> None:
    hit = checker.first_collision(path)
    if hit is not None:
        raise DgsError(code, f"{where} {checker.describe(hit)}")
