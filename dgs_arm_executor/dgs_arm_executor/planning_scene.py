"""Collision checks of arm and hand against themselves, the cell and the observed cloud, with Pinocchio and coal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise, product

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from dgs_arm_executor.ik import T_TOOL0_TCP
from dgs_arm_executor.obstacle_cloud import CarriedBox, ObstacleCloud
from dgs_arm_executor.robot_geometry import (
    CHAIN,
    ENVIRONMENT,
    TABLE,
    WHOLE_HAND,
    checked_pairs,
    load_robot_geometry,
    model_order,
)
from dgs_arm_executor.safety import Envelope
from dgs_description.frames import TOOL0, Array
from dgs_description.parameters import parameter

CLOUD = "observed cloud"
CARRIED = "carried object"
BESIDE = "observed cloud beside the object"
"""What the carried object has to pass by: the observed cloud, less all that may be the object itself."""

_REACHES_THE_CLOUD = CHAIN[2:]
_REACHED_BY_THE_LOAD = (*ENVIRONMENT, *CHAIN[:4])

PATH_STEP = 0.03
"""Largest joint step between two checked states of a search [rad]; the hand then moves 3 cm, 4 cm at most."""
_BOX_MARGIN = 0.005
"""Plans keep so far inside of the safety envelope's box [m]."""


@dataclass(frozen=True)
class SceneSettings(Envelope):
    """Clearances [m]; positive keeps things apart, negative forgives that much penetration.

    The envelope's box is where the safety check wants the TCP to stay.
    """

    # Between two checked states things come nearer.
    arm_clearance: float = parameter(
        0.005, "Robot and what it carries to the cell and to itself [m].", 0.0, 0.1
    )
    hand_table_clearance: float = parameter(
        0.0, "Open hand to the table; negative forgives [m].", -0.02, 0.05
    )
    closed_table_clearance: float = parameter(
        -0.012, "Closed hand to the table: compliant fingers may touch it [m].", -0.03, 0.05
    )
    transfer_clearance: float = 0.005
    """Robot to the cloud on the way to the stand-off, besides: the cloud is noisy and has no far sides."""


class CollisionChecker:
    """Answers for one shape of the hand and one set of obstacles. Not for use from several threads at once.

    Attributes:
        lower, upper: (6,) limits of the arm's joints [rad].
    """

    def __init__(
        self,
        model: pin.Model,
        shapes: pin.GeometryModel,
        parts: Sequence[str],
        margins: Sequence[float],
        box: Array | None = None,
    ):
        """Take the parts of a scene.

        Args:
            model, shapes: of the arm, and with their collision pairs.
            parts: name of the part per shape.
            margins: per pair, how near it may come [m].
            box: (2, 3) lower and upper corner of where the TCP may be, `base_link` [m]; None = anywhere.
        """
        self._model, self._shapes, self._parts, self._order = model, shapes, parts, model_order(model)
        self.lower, self.upper = np.empty(6), np.empty(6)
        self.lower[self._order], self.upper[self._order] = model.lowerPositionLimit, model.upperPositionLimit
        self._box: list[list[float]] | None = None if box is None else box.tolist()
        if box is not None:
            tool0 = model.frames[model.getFrameId(TOOL0)]
            self._last_joint, self._tcp_in_joint = tool0.parentJoint, tool0.placement.act(T_TOOL0_TCP[:3, 3])
        self._data, self._geometry_data = model.createData(), shapes.createData()
        for request, margin in zip(self._geometry_data.collisionRequests, margins, strict=True):
            request.security_margin = margin
        # Made when the margins are set: it widens the boxes around the shapes by them.
        self._broad_phase = pin.BroadPhaseManager_NaiveCollisionManager(model, shapes, self._geometry_data)

    def in_collision(self, q: ArrayLike) -> bool:
        """Whether the arm at (6,) joints [rad] touches anything, or the TCP is outside of its box."""
        state = np.asarray(q, float)[self._order]
        hit = pin.computeCollisions(self._model, self._data, self._broad_phase, state, True)
        return bool(hit) or self._outside() is not None

    def _outside(self) -> list[float] | None:
        """The TCP of the state that was looked at last [m] if it is outside of its box."""
        if self._box is None:
            return None
        x, y, z = tcp = self._data.oMi[self._last_joint].act(self._tcp_in_joint).tolist()
        # Plain numbers: this is asked of every state, and numpy would take as long as the collision check.
        low, high = self._box
        inside = low[0] < x < high[0] and low[1] < y < high[1] and low[2] < z < high[2]
        return None if inside else tcp

    def contacts(self, q: ArrayLike) -> list[tuple[str, str]]:
        """Names of all pairs of parts that touch at (6,) joints [rad]."""
        state = np.asarray(q, float)[self._order]
        pin.computeCollisions(self._model, self._data, self._shapes, self._geometry_data, state, False)
        results = zip(self._shapes.collisionPairs, self._geometry_data.collisionResults, strict=True)
        touching = [pair for pair, result in results if result.isCollision()]
        return list(dict.fromkeys((self._parts[pair.first], self._parts[pair.second]) for pair in touching))

    def first_collision(self, path: Array) -> Array | None:
        """First colliding state (6,) on the joint polyline (N, 6), or of a single state (6,) [rad]; None = all free.

        The ends are looked at first and then ever finer in between, because that finds a collision soonest.
        """
        dense = densify(np.asarray(path, float).reshape(-1, 6), PATH_STEP)
        for k in _coarse_to_fine(len(dense)):
            if self.in_collision(dense[k]):
                return dense[k]
        return None

    def describe(self, q: ArrayLike) -> str:
        """What touches what at (6,) joints, for a sentence."""
        pairs = self.contacts(q)
        tcp = self._outside()
        if not pairs and tcp is not None:
            return f"the TCP leaves its box at ({tcp[0]:.3f}, {tcp[1]:.3f}, {tcp[2]:.3f}) m"
        return " and ".join(f"{a} meets {b}" for a, b in pairs[:2]) or "no contact"


@dataclass
class PlanningScene:
    """The cell as far as it is known: URDF plus the newest cloud."""

    cloud: ObstacleCloud = field(default_factory=ObstacleCloud)
    settings: SceneSettings = field(default_factory=SceneSettings)

    def checker(
        self,
        hand_joints: ArrayLike,
        *,
        released: NDArray[np.bool_] | None = None,
        carried: CarriedBox | None = None,
        own: NDArray[np.bool_] | None = None,
        hand_on_table: bool = False,
        use_cloud: bool = True,
        cloud_clearance: float = 0.0,
    ) -> CollisionChecker:
        """A checker for one shape of the hand; takes about 4 ms to build, 0.02 ms per check.

        Args:
            hand_joints: (J,) [rad].
            released: (V,) voxels of the cloud that do not count.
            carried: what the hand holds.
            own: (V,) voxels that do not count for what is carried; None = those of `released`.
            hand_on_table: the hand is closed about something on the table and may touch it.
            cloud_clearance: distance of the robot to the cloud [m].
        """
        settings, geometry = self.settings, load_robot_geometry()
        parts, (arm, shapes) = list(geometry.parts), geometry.with_hand(hand_joints)
        to_table = settings.closed_table_clearance if hand_on_table else settings.hand_table_clearance
        pairs = [
            (a, b, to_table if (a, b) == (WHOLE_HAND, TABLE) else settings.arm_clearance)
            for a, b in checked_pairs(geometry)
        ]
        clouds = {CLOUD: released, BESIDE: released if own is None else own}
        for name in clouds if carried is not None else (CLOUD,):
            gone = clouds[name]
            octree = self.cloud.octree(None if gone is None else ~gone) if use_cloud else None
            if octree is not None:
                shapes.addGeometryObject(pin.GeometryObject(name, 0, 0, pin.SE3.Identity(), octree))
                parts.append(name)
        pairs += [(part, CLOUD, cloud_clearance) for part in _REACHES_THE_CLOUD]
        if carried is not None:
            shapes.addGeometryObject(carried_shape(arm, carried))
            parts.append(CARRIED)
            near = [part for part in _REACHED_BY_THE_LOAD if part != TABLE or not hand_on_table]
            pairs += [(CARRIED, part, settings.arm_clearance) for part in near]
            pairs.append((CARRIED, BESIDE, 0.0))
        margins = add_pairs(shapes, parts, pairs)
        box = np.array([settings.tcp_lower, settings.tcp_upper])
        box += np.array([[_BOX_MARGIN], [-_BOX_MARGIN]])
        return CollisionChecker(arm, shapes, parts, margins, box)


def add_pairs(
    shapes: pin.GeometryModel, parts: Sequence[str], pairs: Sequence[tuple[str, str, float]]
) -> list[float]:
    """Have pairs of parts checked, given the part of every shape, with the margin of each pair [m].

    Returns:
        The margin of every pair of shapes that this adds.
    """
    numbers: dict[str, list[int]] = {}
    for index, part in enumerate(parts):
        numbers.setdefault(part, []).append(index)
    margins = []
    for a, b, margin in pairs:
        for first, second in product(numbers.get(a, ()), numbers.get(b, ())):
            shapes.addCollisionPair(pin.CollisionPair(first, second))
            margins.append(margin)
    return margins


def densify(path: Array, step: float) -> Array:
    """Joint polyline (N, 6) with points added so that no joint moves more than `step` between two [rad]."""
    if len(path) < 2:
        return path
    pieces = [path[:1]]
    for a, b in pairwise(path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / step)))
        pieces.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(pieces)


def _coarse_to_fine(count: int) -> list[int]:
    """Indices 0..count-1: the last, the first, then halving gaps."""
    order = dict.fromkeys([count - 1, 0])
    stride = 1 << (count - 1).bit_length()
    while stride >= 1:
        order |= dict.fromkeys(range(0, count, stride))
        stride //= 2
    return list(order)


def carried_shape(model: pin.Model, carried: CarriedBox) -> pin.GeometryObject:
    """The box of what is held, fixed to the hand."""
    size = np.maximum(carried.size, 0.01)
    tool0 = model.frames[model.getFrameId(TOOL0)]
    placement = tool0.placement * pin.SE3(T_TOOL0_TCP) * pin.SE3(carried.T_tcp_box)
    return pin.GeometryObject("carried", tool0.parentJoint, tool0.parentFrame, placement, coal.Box(*size))
