"""A hand: kinematics (forward, inverse) and shape (spheres, boxes), from the folder that describes it.

Frames: `hand_base` has x out of the palm, y towards the thumb's side, z towards the fingertips. `hand_tcp` is the same
turned about y, so that its z is the way in which the hand approaches. The first finger, the *thumb*, opposes the
others. Every finger is a chain of four joints: `joint1` at the finger's base frame F_i (x = flexion axis, y = distal,
z = palmar), then one at the end of each link. By default the first turns about z (yaw), the others about x (pitch,
middle, distal). A joint may be driven, follow another, or be locked. Lengths in metres, angles in radians.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from dgs_description.frames import Array
from dgs_description.hand_facts import Capsule, GraspFacts, Index, LinkFacts, Mask

_Terms = list[tuple[int, Array]]
"""Which of three axes are needed, with (F, ..., 1) weights."""
JOINTS_PER_FINGER = 4
"""Joints of every finger's chain; what a hand lacks is locked."""


@dataclass(frozen=True, eq=False)
class HandModel:
    """F fingers of four joints. Joint arrays are (..., 4 F), or (..., F, 4), finger by finger, thumb first.

    Attributes:
        name, title: of the folder; for people.
        fingers: names.
        lower, upper, effort: (4 F,) limits [rad] and torques [Nm].
        source: (4 F,) the joint that each joint copies, itself where it is driven; ratio: (4 F,) by which factor.
        locked: (4 F,) joints that do not move.
        speed: software limit of every joint [rad/s]; damping [Nms/rad], friction [Nm] of every joint.
        T_mount_base: (4, 4) `hand_base` in the flange's face `hand_mount`.
        T_base_tcp: (4, 4) `hand_tcp` in `hand_base`.
        bases: (F, 4, 4) pose of every F_i in `hand_base`.
        axes: (F, 4, 3) of the joints, steps: (F, 4, 3) from each joint to the next, the last to the fingertip, in the
            link's frame.
        spread: (F,) yaw at which neighbours stay clear of each other [rad].
        capsules: (F, 3) of proximal, middle and distal link; radii are the same in all fingers.
        spheres: how many stand for each of the three.
        palm: mass; palm_boxes: (B, 6) x0 x1 y0 y1 z0 z1 of its collision boxes in `hand_base` [m].
        links: of every finger, knuckle to distal.
        grasp: how it grasps.
        protocol: `module:Class` by which the driver speaks with it; empty: unknown.
    """

    name: str
    title: str
    fingers: tuple[str, ...]
    lower: Array
    upper: Array
    effort: Array
    source: Index
    ratio: Array
    locked: Mask
    speed: float
    damping: float
    friction: float
    T_mount_base: Array
    T_base_tcp: Array
    bases: Array
    axes: Array
    steps: Array
    spread: Array
    capsules: tuple[tuple[Capsule, ...], ...]
    spheres: tuple[int, ...]
    palm: LinkFacts
    palm_boxes: Array
    links: tuple[LinkFacts, ...]
    grasp: GraspFacts
    protocol: str

    @property
    def finger_count(self) -> int:
        """F."""
        return len(self.fingers)

    @property
    def joint_count(self) -> int:
        """4 F."""
        return len(self.lower)

    @property
    def shape(self) -> tuple[int, int]:
        """(F, 4)."""
        return self.finger_count, JOINTS_PER_FINGER

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of all joints: `thumb_joint1` ..."""
        return tuple(f"{finger}_joint{k + 1}" for finger in self.fingers for k in range(JOINTS_PER_FINGER))

    @cached_property
    def driven(self) -> Index:
        """(D,) rows of the joints that have a motor."""
        return np.flatnonzero((self.source == np.arange(self.joint_count)) & ~self.locked)

    @cached_property
    def driven_joints(self) -> tuple[str, ...]:
        """Names of the driven joints."""
        return tuple(self.joints[k] for k in self.driven)

    @cached_property
    def coupled(self) -> Mask:
        """(F,) fingers whose distal joint follows their middle one."""
        middle = JOINTS_PER_FINGER * np.arange(self.finger_count) + 2
        return np.asarray(self.source[middle + 1] == middle)

    @cached_property
    def base_poses(self) -> Array:
        """(F, 4, 4) pose of every F_i in `hand_tcp`."""
        turn, poses = self.T_base_tcp[:3, :3], self.bases.copy()
        poses[:, :3, 3] = (poses[:, :3, 3] - self.T_base_tcp[:3, 3]) @ turn
        poses[:, :3, :3] = turn.T @ poses[:, :3, :3]
        return poses

    @cached_property
    def T_mount_tcp(self) -> Array:
        """(4, 4) `hand_tcp` in the flange's face."""
        return self.T_mount_base @ self.T_base_tcp

    @cached_property
    def flexes(self) -> Mask:
        """(F, 4) joints that bend their finger; the others turn or spread it."""
        return np.asarray(self.axes[..., 0] > 0.99)

    @cached_property
    def straight(self) -> Array:
        """(4 F,) every joint as near to 0 as its limits allow [rad]."""
        return self.expand(self.reduce(np.clip(0.0, self.lower, self.upper)))

    @cached_property
    def open_hand(self) -> Array:
        """(4 F,) straight fingers, fanned out: neighbours do not touch, and what sticks between them falls out."""
        joints = self.straight.reshape(self.shape).copy()
        joints[:, 0] = self.spread
        return self.expand(self.reduce(joints.ravel()))

    @cached_property
    def beyond(self) -> Array:
        """(F, 4) how far past its final joints a finger that meets nothing bends on, feeling for the object [rad]."""
        return self.flexes * self.grasp.beyond

    def split(self, joints: Array) -> Array:
        """(..., F, 4) of (..., 4 F) or (..., F, 4)."""
        q = np.asarray(joints, dtype=np.float64)
        return q if q.shape[-2:] == self.shape else q.reshape(*q.shape[:-1], *self.shape)

    def expand(self, driven: Array) -> Array:
        """(..., 4 F) joints of (..., D) driven ones: those that follow and those that are locked filled in [rad]."""
        values = np.asarray(driven, dtype=np.float64)
        joints = np.broadcast_to(self.lower, (*values.shape[:-1], self.joint_count)).copy()
        joints[..., self.driven] = values
        moving = np.flatnonzero(~self.locked)
        joints[..., moving] = joints[..., self.source[moving]] * self.ratio[moving]
        return joints

    def reduce(self, joints: Array) -> Array:
        """(..., D) driven joints of (..., 4 F)."""
        return np.asarray(np.asarray(joints, dtype=np.float64)[..., self.driven])

    def settled(self, joints: Array) -> Array:
        """(..., 4 F) joints that the couplings allow: measured ones that hang together take their mean [rad]."""
        q = self.split(joints)
        q = q.reshape(*q.shape[:-2], self.joint_count)
        return self.expand(q @ self._means)

    @cached_property
    def _means(self) -> Array:
        """(4 F, D) weights of the mean of a driven joint and of those that follow it, each over its ratio."""
        members = (self.source[:, None] == self.driven) & ~self.locked[:, None]
        return members / self.ratio[:, None] / members.sum(axis=0)

    # Kinematics.

    @cached_property
    def _turns(self) -> Array:
        """(F, 4, 3, 3) rotations whose z is the joint's axis; an axis of the frame is reached by exact permutation."""
        z = self.axes
        helper = np.eye(3)[(np.abs(z).argmax(axis=-1) + 1) % 3]
        x = helper - (helper * z).sum(-1, keepdims=True) * z
        x = x / np.linalg.norm(x, axis=-1, keepdims=True)
        return np.stack([x, np.cross(z, x), z], axis=-1)

    @cached_property
    def _chain(self) -> list[tuple[list[_Terms] | None, _Terms]]:
        """Per joint: how its axes come from the last joint's (None: they are the same), and the way to it."""
        turns = self._turns
        chain: list[tuple[list[_Terms] | None, _Terms]] = []
        for k in range(1, JOINTS_PER_FINGER):
            back = turns[:, k - 1].transpose(0, 2, 1)
            turn, way = back @ turns[:, k], np.einsum("fij,fj->fi", back, self.steps[:, k - 1])
            same = np.array_equal(turn, np.broadcast_to(np.eye(3), turn.shape))
            chain.append((None if same else [_terms(turn[:, :, i]) for i in range(3)], _terms(way)))
        return chain

    @cached_property
    def _root(self) -> tuple[Array, list[Array]]:
        """(3, F, 1) place and axes of every finger's first joint at angle zero, in `hand_tcp`."""
        turn = self.base_poses[:, :3, :3] @ self._turns[:, 0]
        return self.base_poses[:, :3, 3].T[..., None], [turn[:, :, k].T[..., None] for k in range(3)]

    def _frames(self, joints: Array, last: int = JOINTS_PER_FINGER - 1) -> list[tuple[Array, list[Array]]]:
        """Per joint: its origin (3, F, N) and three axes (3, F, N) in `hand_tcp`, of N hands; the third is the joint's.

        Coordinates first and hands last make long inner loops.
        """
        q = np.ascontiguousarray(self.split(joints).reshape(-1, *self.shape).T)
        cos, sin = np.cos(q), np.sin(q)
        root, (x, y, z) = self._root
        origin, frames = np.broadcast_to(root, (3, *q.shape[1:])), []
        for k in range(last + 1):
            if k:
                turn, way = self._chain[k - 1]
                origin = origin + _sum((x, y, z), way)
                if turn is not None:
                    x, y, z = (_sum((x, y, z), terms) for terms in turn)
            x, y = cos[k] * x + sin[k] * y, cos[k] * y - sin[k] * x
            frames.append((origin, [x, y, z]))
        return frames

    def _local(self, link: int, points: Array) -> _Terms:
        """(F, P, 3) points of a link, in its joint's axes."""
        return _terms(np.einsum("fji,fpj->fpi", self._turns[:, link], points))

    def finger_points(self, joints: Array, link: int, local: Array) -> Array:
        """Points that are fixed to one link of every finger, in `hand_tcp`.

        Args:
            joints: (..., 4 F) [rad].
            link: 0 knuckle .. 3 distal.
            local: (F, P, 3) coordinates in that link's frame [m].

        Returns:
            (..., F, P, 3) positions [m].
        """
        batch, frame = self.split(joints).shape[:-1], self._frames(joints, link)[-1]
        points = _fixed(frame, self._local(link, local))
        return np.ascontiguousarray(points.transpose(3, 1, 2, 0)).reshape(*batch, *local.shape[1:])

    def fingertips(self, joints: Array) -> Array:
        """Fingertip points (..., F, 3) in `hand_tcp` [m] of (..., 4 F) joints [rad]."""
        return self.finger_points(joints, 3, self.steps[:, 3:])[..., 0, :]

    def end_balls(self, joints: Array) -> Array:
        """Centres (..., F, 3) in `hand_tcp` of the balls that end the fingers [m]; their radius is `ball_radius`.

        The fingertip point lies nearly on a ball's surface: what touches a flat table is the ball.
        """
        return self.finger_points(joints, 3, self._ball_places)[..., 0, :]

    @cached_property
    def _ball_places(self) -> Array:
        return np.array([[(0.0, links[2].end, links[2].height)] for links in self.capsules])

    @property
    def ball_radius(self) -> float:
        """Of the balls that end the fingers [m]."""
        return self.capsules[0][2].radius

    def end_ball_jacobian(self, joints: Array) -> tuple[Array, Array]:
        """Centres (..., F, 3) of the end balls [m], and (..., F, 3, 4) their change by each joint of their finger:
        the joint's axis x the way from there to the ball [m/rad]."""
        batch, frames = self.split(joints).shape[:-1], self._frames(joints)
        ball = _fixed(frames[-1], self._local(3, self._ball_places))[:, :, 0]
        levers = np.stack([ball - origin for origin, _ in frames])
        axes = np.stack(np.broadcast_arrays(*(axes[2] for _, axes in frames)))
        moves = np.cross(axes, levers, axis=1)
        return ball.T.reshape(*batch, 3), moves.T.reshape(*batch, 3, JOINTS_PER_FINGER)

    def link_frames(self, joints: Array) -> Array:
        """Poses (F, 4, 4, 4) in `hand_tcp` of every finger's knuckle to distal link, for (4 F,) joints."""
        poses = np.tile(np.eye(4), (*self.shape, 1, 1))
        for k, (origin, axes) in enumerate(self._frames(joints)):
            turn = np.stack(np.broadcast_arrays(*axes), axis=-1)[:, :, 0].transpose(1, 0, 2)
            poses[:, k, :3, :3] = turn @ self._turns[:, k].transpose(0, 2, 1)
            poses[:, k, :3, 3] = origin[:, :, 0].T
        return poses

    # Shape.

    @cached_property
    def sphere_phalanx(self) -> Index:
        """(S,) phalanx (0 proximal, 1 middle, 2 distal) of every sphere of a finger."""
        return np.repeat(np.arange(3), self.spheres)

    @cached_property
    def sphere_radii(self) -> Array:
        """(S,) radius of every sphere of a finger [m]."""
        return np.array([link.radius for link in self.capsules[0]])[self.sphere_phalanx]

    @cached_property
    def all_radii(self) -> Array:
        """(F S,) radius of every sphere of the hand [m]."""
        return np.tile(self.sphere_radii, self.finger_count)

    @cached_property
    def _sphere_places(self) -> list[_Terms]:
        """Per phalanx: along the capsules, never outside of them; between them at most 2.2 mm are missed."""
        places = []
        for k, count in enumerate(self.spheres):
            rows = [
                [(0.0, y, c[k].height) for y in np.linspace(c[k].start, c[k].end, count)]
                for c in self.capsules
            ]
            places.append(self._local(k + 1, np.array(rows)))
        return places

    def finger_spheres(self, joints: Array) -> Array:
        """Centres (..., F, S, 3) in `hand_tcp` [m] of the spheres that stand for the fingers."""
        batch, frames = self.split(joints).shape[:-1], self._frames(joints)
        points = [_fixed(frames[k + 1], places) for k, places in enumerate(self._sphere_places)]
        return np.concatenate(points, axis=2).transpose(3, 1, 2, 0).reshape(*batch, sum(self.spheres), 3)

    def palm_points(self, step: float = 0.010) -> Array:
        """Points (P, 3) on the palm boxes' surfaces in `hand_tcp`, about `step` apart [m]."""
        points = []
        for box in self.palm_boxes.reshape(-1, 3, 2):
            axes = [np.linspace(a, b, max(2, int(np.ceil((b - a) / step)) + 1)) for a, b in box]
            grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
            shell = np.ones(grid.shape[:3], dtype=bool)
            shell[1:-1, 1:-1, 1:-1] = False
            points.append(grid[shell])
        shell_points = (np.concatenate(points) - self.T_base_tcp[:3, 3]) @ self.T_base_tcp[:3, :3]
        return np.unique(np.round(shell_points, 5), axis=0)

    def pre_grasp(self, joints: Array, active: Mask | None = None) -> Array:
        """Pre-grasp of a final grasp by equation (9): scaled joints of the active fingers, unchanged idle ones.

        Args:
            joints: (..., 4 F) or (..., F, 4) final joints [rad].
            active: (F,) or (..., F) which fingers take part; None = all.

        Returns:
            joints of the same shape as given [rad].
        """
        q = self.split(joints)
        share = np.where(self.flexes, self.grasp.pre_grasp, 1.0)
        scaled = np.clip(q * share, self.split(self.lower), self.split(self.upper))
        if active is not None:
            scaled = np.where(np.asarray(active)[..., None], scaled, q)
        driven = self.reduce(scaled.reshape(*scaled.shape[:-2], self.joint_count))
        return self.expand(driven).reshape(np.shape(joints))


def _terms(weights: Array) -> _Terms:
    """(F, ..., 3) weights of three axes; those that no finger needs are left out."""
    return [(k, weights[..., k, None]) for k in range(3) if weights[..., k].any()]


def _sum(axes: Sequence[Array], terms: _Terms) -> Array:
    """Weighted sum of three axes (3, F, ..., N)."""
    return sum((axes[k] * weight for k, weight in terms), start=np.zeros((1, 1, 1)))


def _fixed(frame: tuple[Array, list[Array]], places: _Terms) -> Array:
    """(3, F, P, N) points of a link whose frame is given."""
    origin, axes = frame
    return sum((axes[k][:, :, None] * weight for k, weight in places), start=origin[:, :, None])
