"""What the pick planner gives: a whole planned pick, why better grasps were refused, and the settings of both."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from dgs_arm_executor.obstacle_cloud import ObstacleCloud
from dgs_arm_executor.situation import Load
from dgs_arm_executor.timing import Trajectory
from dgs_description.cell import CELL
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_description.grasp import GraspSet
from dgs_description.parameters import parameter
from dgs_description.pick import LIFT, MOTION_SPEED, STAND_OFF
from dgs_description.words import plural


@dataclass(frozen=True)
class Rejection:
    """Why a grasp was not taken; `index` counts in the set of the goal."""

    index: int
    code: ErrorCode
    reason: str


@dataclass(frozen=True)
class PickPlan:
    """Everything the arm will do, planned before it moves.

    Attributes:
        index: of the chosen grasp in the set of the goal.
        load: the chosen grasp, and what the hand will hold after the lift.
        trajectories: by stage in order: escape (only where the arm starts inside the observed cloud), transfer,
            approach, advance (only of a grasp with a motion), retreat (only after a push), lift, carry (not after a
            push) and home; the last two only where the object is not to be kept.
        shaping_on_the_way: the transfer is free of collisions whatever the hand has reached of its pre-grasp shape.
    """

    index: int
    load: Load
    trajectories: dict[str, Trajectory]
    shaping_on_the_way: bool = False

    @property
    def grasp(self) -> GraspSet:
        """The chosen grasp."""
        return self.load.grasp

    @property
    def duration(self) -> float:
        """Time that the arm moves [s]."""
        return sum(trajectory.duration for trajectory in self.trajectories.values())


@dataclass(frozen=True)
class PickAnswer:
    """Answer of the planner: a plan or None, and why better-scored grasps were refused."""

    plan: PickPlan | None
    rejections: tuple[Rejection, ...]

    def chosen(self) -> PickPlan:
        """The plan. Raises DgsError NO_FEASIBLE_GRASP where there is none."""
        if self.plan is None:
            raise self.refusal()
        return self.plan

    def refusal(self) -> DgsError:
        """NO_FEASIBLE_GRASP, with how many grasps were refused for which reason."""
        counts = Counter(rejection.code.name for rejection in self.rejections)
        reasons = ", ".join(f"{count} {name}" for name, count in counts.most_common())
        none = f"none of {plural(len(self.rejections), 'grasp')} can be executed: {reasons}"
        return DgsError(ErrorCode.NO_FEASIBLE_GRASP, none)


@dataclass(frozen=True)
class Prepared:
    """A pick that was planned from where the goal before would end, while that was on its way there.

    Attributes:
        answer: of the planner.
        cloud: obstacles that it was planned with.
        seconds: time that planning took [s].
    """

    answer: PickAnswer
    cloud: ObstacleCloud
    seconds: float


@dataclass(frozen=True)
class Wish:
    """How far a pick is to go.

    Attributes:
        plan_only: nothing is moved.
        keep_holding: it ends after the lift.
        stay_over_bin: it ends over the bin with an open hand, not at home (a push does); another one may follow.
    """

    plan_only: bool = False
    keep_holding: bool = False
    stay_over_bin: bool = False


@dataclass(frozen=True)
class PickSettings:
    """Geometry, speeds and time limits of a pick."""

    home: tuple[float, ...] = CELL.home
    """Arm joints [rad]."""
    lift: float = parameter(LIFT, "Straight lift after closing [m].", 0.02, 0.4)
    release_clearance: float = parameter(0.05, "Between the bin's rim and the object [m].", 0.0, 0.4)
    speed: float = parameter(1.0, "Share of the joint velocity limits, transfer and home.", 0.05, 1.0)
    carry_speed: float = parameter(0.8, "The same while carrying.", 0.05, 1.0)
    approach_speed: float = parameter(0.3, "TCP speed of the approach [m/s].", 0.005, 0.5)
    advance_speed: float = parameter(
        MOTION_SPEED, "TCP speed of a grasp's motion and of a push [m/s].", 0.005, 0.5
    )
    lift_speed: float = parameter(0.3, "TCP speed of the lift [m/s].", 0.005, 0.5)
    planning_time: float = parameter(10.0, "After so long no further grasp is looked at [s].", 0.1, 120.0)
    path_time: float = 0.6
    """Processor time for one query of the sampling planner [s]: a busy machine makes it slower, not worse."""
    sampled_goals: int = 2
    """So many IK branches per grasp get the sampling planner."""
    release_tries: int = 24
    """So many states over the bin are looked at, nearest first."""

    def backed_off(self, T_base_tcp: Array) -> Array:
        """(4, 4) the stand-off of a grasp at (4, 4)."""
        return T_base_tcp @ transform(position=(0.0, 0.0, -STAND_OFF))

    def lifted(self, T_base_tcp: Array) -> Array:
        """(4, 4) where the lift from (4, 4) ends."""
        return transform(position=(0.0, 0.0, self.lift)) @ T_base_tcp
