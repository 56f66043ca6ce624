"""Drives a planned pick through PyBullet every 2 ms with the true objects, and counts what touches and what exceeds.

Nothing of the planner's geometry, collision or timing code is used: the robot and the cell are the URDFs as PyBullet
reads them, the objects are those of the scene, and trajectories are interpolated as a joint trajectory controller does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pybullet
from numpy.typing import NDArray

from dgs_arm_executor.pick_types import OPEN_HAND, PickPlan
from dgs_arm_executor.timing import Trajectory
from dgs_description.frames import HAND_BASE, HAND_TCP
from dgs_description.joints import ARM_ACCELERATION, ARM_JOINTS, FINGERS, HAND_JOINTS
from dgs_description.urdf import urdf_path
from dgs_sim_bridge.world.physics import add_object, joint_indices, new_client
from dgs_sim_bridge.world.scenes import PlacedObject

Array = NDArray[np.float64]
Pose = tuple[tuple[float, ...], tuple[float, ...]]
"""PyBullet's: position [m] and quaternion xyzw."""

TIME_STEP = 0.002
"""Between two looked-at states [s]."""
MARGIN = 0.001
"""By so much Bullet's convex hulls are larger than what they stand for: shallower contacts are none [m]."""
HAND_STEPS = 25
"""States of a hand motion at a standing arm."""
HAND = "hand"
_CHAIN = (
    "base_link_inertia",
    "shoulder_link",
    "upper_arm_link",
    "forearm_link",
    "wrist_1_link",
    "wrist_2_link",
    "wrist_3_link",
    HAND,
)
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

    def add(self, stage: str, a: str, b: str, depth: float) -> None:
        """Count a contact."""
        key = f"{stage}: {a} - {b}"
        count, deepest = self.collisions.get(key, (0, 0.0))
        self.collisions[key] = count + 1, max(deepest, depth)


def interpolate(trajectory: Trajectory, step: float = TIME_STEP) -> tuple[Array, Array, Array, Array]:
    """Quintic interpolation of positions, velocities and accelerations, as ros2_controllers' trajectory controller.

    Returns:
        (M,) times [s] and (M, 6) positions, velocities, accelerations, the last state being the trajectory's last.
    """
    knots = trajectory.times
    times = np.append(np.arange(0.0, knots[-1], step), knots[-1])
    k = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
    h = (knots[k + 1] - knots[k])[:, None]
    x = ((times - knots[k])[:, None]) / h
    q, v, a = trajectory.positions, trajectory.velocities, trajectory.accelerations
    d, v0, v1, a0, a1 = q[k + 1] - q[k], h * v[k], h * v[k + 1], h**2 * a[k], h**2 * a[k + 1]
    c = (
        q[k],
        v0,
        a0 / 2,
        10 * d - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
        -15 * d + 8 * v0 + 7 * v1 + 1.5 * a0 - a1,
        6 * d - 3 * (v0 + v1) - 0.5 * (a0 - a1),
    )
    position = sum(c[n] * x**n for n in range(6))
    velocity = sum(n * c[n] * x ** (n - 1) for n in range(1, 6)) / h
    acceleration = sum(n * (n - 1) * c[n] * x ** (n - 2) for n in range(2, 6)) / h**2
    return times, np.asarray(position), np.asarray(velocity), np.asarray(acceleration)


class BulletCell:
    """Robot, cell and true objects in a PyBullet world without dynamics; use as a context manager."""

    def __init__(self, objects: Sequence[PlacedObject]):
        self.client = new_client()
        flags = pybullet.URDF_USE_SELF_COLLISION | pybullet.URDF_MAINTAIN_LINK_ORDER
        self.robot = self._load("robot", flags)
        self.cell = self._load("surroundings", 0)
        self.names = {(self.robot, -1): "base_link", (self.cell, -1): "base_link"}
        for body in (self.robot, self.cell):
            for k in range(pybullet.getNumJoints(body, physicsClientId=self.client)):
                link = pybullet.getJointInfo(body, k, physicsClientId=self.client)[12].decode()
                self.names[body, k] = HAND if _of_hand(link) else link
        index = joint_indices(self.client, self.robot)
        self._arm = [index[name] for name in ARM_JOINTS]
        self._hand = [index[name] for name in HAND_JOINTS]
        info = [pybullet.getJointInfo(self.robot, k, physicsClientId=self.client) for k in self._arm]
        self.lower, self.upper, self.speed = (np.array([row[i] for row in info]) for i in (8, 9, 11))
        self._tool = next(
            k for (body, k), name in self.names.items() if (body, name) == (self.robot, HAND_TCP)
        )
        self._allow_neighbours()
        self.objects = [add_object(self.client, item.model, item.pose) for item in objects]
        for item, body in zip(objects, self.objects, strict=True):
            self.names[body, -1] = f"object {item.model.name}"
            self._filter_standing(body, False)

    def __enter__(self) -> BulletCell:
        return self

    def __exit__(self, *_: object) -> None:
        pybullet.disconnect(physicsClientId=self.client)

    def set_arm(self, q: Array) -> None:
        """Put the arm at (6,) joints [rad]."""
        pybullet.resetJointStatesMultiDof(
            self.robot, self._arm, q[:, None].tolist(), physicsClientId=self.client
        )

    def set_hand(self, q: Array) -> None:
        """Put the hand at (20,) joints [rad]."""
        pybullet.resetJointStatesMultiDof(
            self.robot, self._hand, q[:, None].tolist(), physicsClientId=self.client
        )

    def tcp(self) -> Pose:
        """Position [m] and quaternion xyzw of `hand_tcp`."""
        state = pybullet.getLinkState(
            self.robot, self._tool, computeForwardKinematics=1, physicsClientId=self.client
        )
        return state[4], state[5]

    def pick_up(self, target: int) -> Pose:
        """Pose of an object in `hand_tcp`; from now on it also touches the cell and the other objects."""
        self._filter_standing(target, True)
        pose = pybullet.getBasePositionAndOrientation(target, physicsClientId=self.client)
        return pybullet.multiplyTransforms(*pybullet.invertTransform(*self.tcp()), *pose)

    def carry(self, target: int, tcp_object: Pose) -> None:
        """Put the object to where the hand has it."""
        pose = pybullet.multiplyTransforms(*self.tcp(), *tcp_object)
        pybullet.resetBasePositionAndOrientation(target, *pose, physicsClientId=self.client)

    def nearest_object(self, point: Array) -> int:
        """Body of the object whose surface is nearest to a point (3,) [m]."""
        ball = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=0.001, physicsClientId=self.client)
        probe = pybullet.createMultiBody(0, ball, basePosition=point.tolist(), physicsClientId=self.client)
        gaps = []
        for body in self.objects:
            found = pybullet.getClosestPoints(probe, body, 1.0, physicsClientId=self.client)
            gaps.append(min((contact[8] for contact in found), default=np.inf))
        pybullet.removeBody(probe, physicsClientId=self.client)
        return self.objects[int(np.argmin(gaps))]

    def contacts(self, carried: int | None = None) -> Iterator[tuple[str, str, int, float]]:
        """Parts a and b that touch, b's body, and the depth [m]; a belongs to the robot or is the carried object."""
        pybullet.performCollisionDetection(physicsClientId=self.client)
        for contact in pybullet.getContactPoints(bodyA=self.robot, physicsClientId=self.client):
            if contact[8] < -MARGIN:
                yield (
                    self.names[self.robot, contact[3]],
                    self.names[contact[2], contact[4]],
                    contact[2],
                    -contact[8],
                )
        if carried is not None:
            for contact in pybullet.getContactPoints(bodyA=carried, physicsClientId=self.client):
                if contact[8] < -MARGIN and contact[2] != self.robot:
                    yield "carried object", self.names[contact[2], contact[4]], contact[2], -contact[8]

    def _load(self, name: str, flags: int) -> int:
        return pybullet.loadURDF(
            str(urdf_path(name)), useFixedBase=True, flags=flags, physicsClientId=self.client
        )

    def _filter_standing(self, target: int, touch: bool) -> None:
        for (body, link), _ in self.names.items():
            if body not in (self.robot, target):
                pybullet.setCollisionFilterPair(
                    target, body, -1, link, int(touch), physicsClientId=self.client
                )

    def _allow_neighbours(self) -> None:
        own = [(link, name) for (body, link), name in self.names.items() if body == self.robot]
        for i, (a, name_a) in enumerate(own):
            for b, name_b in own[i + 1 :]:
                known = name_a in _CHAIN and name_b in _CHAIN
                if known and abs(_CHAIN.index(name_a) - _CHAIN.index(name_b)) <= 1:
                    pybullet.setCollisionFilterPair(
                        self.robot, self.robot, a, b, 0, physicsClientId=self.client
                    )
        # The arm's foot is bolted to the pedestal.
        for (body, k), name in self.names.items():
            if body == self.cell and name == "pedestal":
                for link, own_name in own:
                    if own_name == _CHAIN[0]:
                        pybullet.setCollisionFilterPair(
                            self.robot, body, link, k, 0, physicsClientId=self.client
                        )


def _of_hand(link: str) -> bool:
    return link == HAND_BASE or link.split("_")[0] in FINGERS


def check_pick(
    objects: Sequence[PlacedObject], plan: PickPlan, start: Array, step: float = TIME_STEP
) -> CheckedPick:
    """Drive a whole pick and count contacts that are not intended, and limits that are exceeded.

    Intended are: the hand on the target from the approach on, the target on the table where it stood, and nothing else.

    Args:
        objects: what truly stands on the table, poses in `base_link`.
        plan: of `PickPlanner`.
        start: (6,) arm joints at the start [rad].
        step: between two states [s].
    """
    found, candidate = CheckedPick(), plan.candidate
    pre, closed = candidate.pre_grasp_joints, candidate.grasp_joints
    with BulletCell(objects) as cell:
        target = cell.nearest_object(candidate.reference_point)
        here = np.asarray(start, float)
        cell.set_arm(here)
        _move_hand(cell, found, "pre_grasp", OPEN_HAND, pre, None)
        here = _drive(cell, found, "transfer", plan, here, None, None, step)
        here = _drive(cell, found, "approach", plan, here, target, None, step)
        _move_hand(cell, found, "close", pre, closed, target)
        carried = cell.pick_up(target)
        here = _drive(cell, found, "lift", plan, here, target, carried, step)
        if "carry" in plan.trajectories:
            here = _drive(cell, found, "carry", plan, here, target, carried, step)
            pybullet.removeBody(target, physicsClientId=cell.client)
            _move_hand(cell, found, "release", closed, OPEN_HAND, None)
            _drive(cell, found, "home", plan, here, None, None, step)
    return found


def _move_hand(
    cell: BulletCell, found: CheckedPick, stage: str, start: Array, end: Array, target: int | None
) -> None:
    for share in np.linspace(0.0, 1.0, HAND_STEPS):
        cell.set_hand(start + share * (end - start))
        _count(cell, found, stage, target, None)


def _drive(
    cell: BulletCell,
    found: CheckedPick,
    stage: str,
    plan: PickPlan,
    here: Array,
    target: int | None,
    tcp_object: Pose | None,
    step: float,
) -> Array:
    """One arm motion from (6,) joints; returns its last joints."""
    trajectory = plan.trajectories[stage]
    _, q, dq, ddq = interpolate(trajectory, step)
    found.gap = max(found.gap, float(np.abs(q[0] - here).max()))
    tiny = 1e-6
    found.position_violations += int(((q < cell.lower - tiny) | (q > cell.upper + tiny)).any(1).sum())
    speed = np.abs(dq) / cell.speed
    found.velocity_violations += int((speed > 1.0 + tiny).any(1).sum())
    found.velocity_ratio = max(found.velocity_ratio, float(speed.max()))
    found.acceleration_ratio = max(found.acceleration_ratio, float((np.abs(ddq) / ARM_ACCELERATION).max()))
    for joints in q:
        cell.set_arm(joints)
        if target is not None and tcp_object is not None:
            cell.carry(target, tcp_object)
        _count(cell, found, stage, target, None if tcp_object is None else target)
    return q[-1]


def _count(cell: BulletCell, found: CheckedPick, stage: str, target: int | None, carried: int | None) -> None:
    found.states += 1
    for a, b, body, depth in set(cell.contacts(carried)):
        if a == HAND and body == target:
            continue
        found.add(stage, a, b, depth)
