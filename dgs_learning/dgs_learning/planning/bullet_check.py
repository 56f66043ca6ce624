"""Drives a planned pick through PyBullet every 2 ms with the true objects, and counts what touches and what exceeds.

Nothing of the planner's geometry, collision or timing code is used: the robot and the cell are the URDFs as PyBullet
reads them, the objects are those of the scene, and trajectories are interpolated as a joint trajectory controller does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pybullet
from pybullet_utils.bullet_client import BulletClient
from scipy.interpolate import BPoly

from dgs_arm_executor.pick_plan import PickPlan
from dgs_arm_executor.timing import Trajectory
from dgs_description.frames import HAND_BASE, HAND_TCP, Array
from dgs_description.hand import HAND
from dgs_description.joints import ARM_ACCELERATION, ARM_JOINTS
from dgs_description.urdf import urdf_path
from dgs_sim_bridge.world.physics import add_object
from dgs_sim_bridge.world.scenes import PlacedObject

Pose = tuple[tuple[float, ...], tuple[float, ...]]
"""PyBullet's: position [m] and quaternion xyzw."""

TIME_STEP = 0.002
"""Between two looked-at states [s]."""
MARGIN = 0.001
"""By so much Bullet's convex hulls are larger than what they stand for: shallower contacts are none [m]."""
HAND_STEPS = 25
"""States of a hand motion at a standing arm."""
WHOLE_HAND = "hand"
_CHAIN = (
    "base_link_inertia", "shoulder_link", "upper_arm_link", "forearm_link", "wrist_1_link", "wrist_2_link",
    "wrist_3_link", WHOLE_HAND,
)  # fmt: skip
"""Neighbours touch by design; the hand's own links do, too: their shape is the grasp's, not the path's."""


@dataclass
class CheckedPick:
    """What the check of one pick found.

    Attributes:
        states: looked-at states.
        collisions: per stage and pair of parts, number of states and greatest depth [m].
        position_violations, velocity_violations: states beyond a limit of the URDF.
        velocity_ratio, acceleration_ratio: greatest share of the limits.
        gap: greatest jump between two stages [rad].
    """

    states: int = 0
    collisions: dict[str, tuple[int, float]] = field(default_factory=dict)
    position_violations: int = 0
    velocity_violations: int = 0
    velocity_ratio: float = 0.0
    acceleration_ratio: float = 0.0
    gap: float = 0.0


def interpolate(trajectory: Trajectory, step: float = TIME_STEP) -> tuple[Array, Array, Array]:
    """Quintic interpolation of a trajectory, as ros2_controllers' trajectory controller does it.

    Returns:
        (M, 6) positions, velocities, accelerations; the last state is the trajectory's last.
    """
    knots = np.stack([trajectory.positions, trajectory.velocities, trajectory.accelerations], axis=1)
    quintics = BPoly.from_derivatives(trajectory.times, knots)
    times = np.append(np.arange(0.0, trajectory.duration, step), trajectory.duration)
    return quintics(times), quintics(times, 1), quintics(times, 2)


class BulletCell:
    """Robot, cell and true objects in a PyBullet world without dynamics.

    Attributes:
        bullet: the world; it ends with its last user.
        objects: bodies of the objects.
        names: what the links of the bodies are called: the hand's, the arm's, `object NAME`.
        lower, upper, speed: (6,) limits of the arm's joints as the URDF states them [rad], [rad/s].
    """

    def __init__(self, objects: Sequence[PlacedObject]):
        self.bullet = BulletClient(pybullet.DIRECT)
        flags = pybullet.URDF_USE_SELF_COLLISION | pybullet.URDF_MAINTAIN_LINK_ORDER
        self.robot = self.bullet.loadURDF(str(urdf_path("robot")), useFixedBase=True, flags=flags)
        self.cell = self.bullet.loadURDF(str(urdf_path("surroundings")), useFixedBase=True)
        self.names = {(self.robot, -1): "base_link", (self.cell, -1): "base_link"}
        index: dict[str, int] = {}
        for body in (self.robot, self.cell):
            for k in range(self.bullet.getNumJoints(body)):
                info = self.bullet.getJointInfo(body, k)
                index[info[1].decode()] = k
                link = info[12].decode()
                if link == HAND_TCP:
                    self._tcp = k
                self.names[body, k] = (
                    WHOLE_HAND if link == HAND_BASE or link.split("_")[0] in HAND.fingers else link
                )
        self._arm, self._hand = ([index[name] for name in joints] for joints in (ARM_JOINTS, HAND.joints))
        info = [self.bullet.getJointInfo(self.robot, k) for k in self._arm]
        self.lower, self.upper, self.speed = (np.array([row[i] for row in info]) for i in (8, 9, 11))
        self._allow_neighbours()
        self.objects = [add_object(self.bullet, item.model, item.pose) for item in objects]
        for item, body in zip(objects, self.objects, strict=True):
            self.names[body, -1] = f"object {item.model.name}"
            self._touches_what_stands(body, False)

    def set_arm(self, q: Array) -> None:
        """Put the arm at (6,) joints [rad]."""
        self.bullet.resetJointStatesMultiDof(self.robot, self._arm, q[:, None].tolist())

    def set_hand(self, q: Array) -> None:
        """Put the hand at (J,) joints [rad]."""
        self.bullet.resetJointStatesMultiDof(self.robot, self._hand, q[:, None].tolist())

    def tcp(self) -> Pose:
        """Position [m] and quaternion xyzw of `hand_tcp`."""
        state = self.bullet.getLinkState(self.robot, self._tcp, computeForwardKinematics=1)
        return state[4], state[5]

    def pick_up(self, target: int) -> Pose:
        """Pose of an object in `hand_tcp`; from now on it also touches the cell and the other objects."""
        self._touches_what_stands(target, True)
        pose = self.bullet.getBasePositionAndOrientation(target)
        return pybullet.multiplyTransforms(*pybullet.invertTransform(*self.tcp()), *pose)

    def carry(self, target: int, tcp_object: Pose) -> None:
        """Put the object to where the hand has it."""
        pose = pybullet.multiplyTransforms(*self.tcp(), *tcp_object)
        self.bullet.resetBasePositionAndOrientation(target, *pose)

    def nearest_object(self, point: Array) -> int:
        """Body of the object whose surface is nearest to a point (3,) [m]."""
        ball = self.bullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.001)
        probe = self.bullet.createMultiBody(0, ball, basePosition=point.tolist())
        near = [self.bullet.getClosestPoints(probe, body, 1.0) for body in self.objects]
        gaps = [min((contact[8] for contact in points), default=np.inf) for points in near]
        self.bullet.removeBody(probe)
        return self.objects[int(np.argmin(gaps))]

    def contacts(self, carried: int | None = None) -> Iterator[tuple[str, str, int, float]]:
        """Parts a and b that touch, b's body, and the depth [m]; a belongs to the robot or is the carried object."""
        self.bullet.performCollisionDetection()
        for own in (self.robot, carried):
            for contact in () if own is None else self.bullet.getContactPoints(bodyA=own):
                link, body, other, depth = contact[3], contact[2], contact[4], -contact[8]
                if depth > MARGIN and (own == self.robot or body != self.robot):
                    a = self.names[own, link] if own == self.robot else "carried object"
                    yield a, self.names[body, other], body, depth

    def _touches_what_stands(self, target: int, touches: bool) -> None:
        for body, link in self.names:
            if body not in (self.robot, target):
                self.bullet.setCollisionFilterPair(target, body, -1, link, int(touches))

    def _allow_neighbours(self) -> None:
        own = [(link, name) for (body, link), name in self.names.items() if body == self.robot]
        for (a, name_a), (b, name_b) in combinations(own, 2):
            known = name_a in _CHAIN and name_b in _CHAIN
            if known and abs(_CHAIN.index(name_a) - _CHAIN.index(name_b)) <= 1:
                self.bullet.setCollisionFilterPair(self.robot, self.robot, a, b, 0)
        # The arm's foot is bolted to the pedestal.
        (pedestal,) = (k for (body, k), name in self.names.items() if (body, name) == (self.cell, "pedestal"))
        (foot,) = (link for link, name in own if name == _CHAIN[0])
        self.bullet.setCollisionFilterPair(self.robot, self.cell, foot, pedestal, 0)


def check_pick(
    objects: Sequence[PlacedObject], plan: PickPlan, start: Array, step: float = TIME_STEP
) -> CheckedPick:
    """Drive a whole pick and count contacts that are not intended, and limits that are exceeded.

    Intended are: the hand on the target from the approach on, the target on the table where it stood, and nothing else.

    Args:
        objects: what truly stands on the table, poses in `base_link`.
        start: (6,) arm joints at the start [rad].
    """
    return _Drive(BulletCell(objects), plan, np.asarray(start, float), step).whole()


@dataclass
class _Drive:
    """One pick on its way: where the arm is, what the hand may touch, and what it carries."""

    cell: BulletCell
    plan: PickPlan
    here: Array
    step: float
    target: int | None = None
    tcp_object: Pose | None = None
    found: CheckedPick = field(default_factory=CheckedPick)

    def whole(self) -> CheckedPick:
        cell, pre, closed = self.cell, self.plan.grasp.pre_grasp_joints, self.plan.grasp.grasp_joints
        target = cell.nearest_object(self.plan.grasp.reference_point)
        cell.set_arm(self.here)
        self.move_hand("pre_grasp", HAND.open_hand, pre)
        self.move_arm("transfer")
        self.target = target
        self.move_arm("approach")
        self.move_hand("close", pre, closed)
        self.tcp_object = cell.pick_up(target)
        self.move_arm("lift")
        if "carry" in self.plan.trajectories:
            self.move_arm("carry")
            cell.bullet.removeBody(target)
            self.target = self.tcp_object = None
            self.move_hand("release", closed, HAND.open_hand)
            self.move_arm("home")
        return self.found

    def move_hand(self, stage: str, start: Array, end: Array) -> None:
        for share in np.linspace(0.0, 1.0, HAND_STEPS):
            self.cell.set_hand(start + share * (end - start))
            self.count(stage)

    def move_arm(self, stage: str) -> None:
        found, cell = self.found, self.cell
        q, dq, ddq = interpolate(self.plan.trajectories[stage], self.step)
        found.gap = max(found.gap, float(np.abs(q[0] - self.here).max()))
        tiny = 1e-6
        found.position_violations += int(((q < cell.lower - tiny) | (q > cell.upper + tiny)).any(1).sum())
        speed = np.abs(dq) / cell.speed
        found.velocity_violations += int((speed > 1.0 + tiny).any(1).sum())
        found.velocity_ratio = max(found.velocity_ratio, float(speed.max()))
        share = float((np.abs(ddq) / ARM_ACCELERATION).max())
        found.acceleration_ratio = max(found.acceleration_ratio, share)
        for joints in q:
            cell.set_arm(joints)
            if self.target is not None and self.tcp_object is not None:
                cell.carry(self.target, self.tcp_object)
            self.count(stage)
        self.here = q[-1]

    def count(self, stage: str) -> None:
        self.found.states += 1
        carried = None if self.tcp_object is None else self.target
        for a, b, body, depth in set(self.cell.contacts(carried)):
            if a != WHOLE_HAND or body != self.target:
                key = f"{stage}: {a} - {b}"
                count, deepest = self.found.collisions.get(key, (0, 0.0))
                self.found.collisions[key] = count + 1, max(deepest, depth)
