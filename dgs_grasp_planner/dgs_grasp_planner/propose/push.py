"""Proposes pushes towards the table's edge of what the hand cannot have as it lies, until it sticks out far enough.

That is what is too wide for the hand, and what a grasp has failed on. The hand stands behind the thing, nearly upright,
the backs of two straight fingers against its far side. Straight fingers do not press on the table, and two of them turn
a box until its side lies against both.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import islice, product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import binary_erosion, maximum_filter
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.height_field import CELL, NEAR, NOTHING, Floats, HeightField
from dgs_grasp_planner.contact.shape import Shape, near_side
from dgs_grasp_planner.propose import edge_pinch, level_pinch
from dgs_grasp_planner.scene import Scene

PUSHING, _BEND = HAND.grasp.push or ((), np.zeros(HAND.finger_count))
"""The two fingers that push, and the pitch of all: the others bend out of the way, to the palm's side."""

# What is pushed, and how far. Lengths in metres, angles in radians.
FIRST = 0.1
"""Share of a thing's far side that is nearer to the hand than where it is taken to be: slanted, it touches early."""
SPLINTER = 0.1
"""Share of a shape's cells: smaller shapes of the same thing, seen or guessed on its far side, are a part of it."""
OVERHANG = 0.065
"""A thing is pushed until so much of it sticks out, or its middle is as near to the edge as it may be."""
SHORT = 0.03
"""A push to the edge ends so much times the tangent of its turn before that, for the thing turns, too."""
ENOUGH = 0.04
"""What sticks out so far is not pushed on, but for domes: the arm turns over what sticks out farther."""
DOME = 0.1
"""Thicker domes cannot be turned over afterwards; other things, thicker than `edge_pinch.HEIGHT`, not be pinched."""
LEAST, LONGEST = 0.005, 0.8
"""Way of the thing."""
GAPS, NARROW = (0.02, 0.01), 0.9
"""Between the fingers and the thing before: with less room behind it, the last, with such a share of the score."""
CLEARANCE = 0.0005
"""Of the fingers above the table: what is as thin as their ends are high is climbed from higher up."""
APART = 0.012
"""To other things, of what moves."""
PALM = 0.008
"""Between the palm and what it leans over."""
INSIDE, ASIDE = 0.06, 0.4
"""What lies beside the free edge is also pushed along it until its middle is so far inside, with this score."""
DETOURS = tuple(np.deg2rad([0.0, 25.0, -25.0, 50.0, -50.0]).tolist())
"""From straight along the edge, all the way, half, or a quarter of it: around what lies there, ..."""
OUTSIDE = 0.15
"""... but no farther from the workspace's middle line than this, or than it lies; ..."""
AROUND = 3
"""... the first so many that are free."""
TURNS = tuple(np.deg2rad([0.0, 20.0, -20.0, 40.0, -40.0, 60.0, -60.0]).tolist())
"""From straight to the edge, about the vertical: where that way is blocked, or the arm does not reach it."""
LEANS = tuple(np.deg2rad([0.0, 25.0, 45.0]).tolist())
"""Of the hand, ahead over the thing: an arm reaches behind what lies far away. With none of these, ..."""
STANDS = ((0.018, 0.26), (0.04, 0.0), (np.inf, -0.17))
"""... so much [rad] behind a thing that is no thicker than [m], upright behind a dome.

Fingers yield. What meets them below their ends' middle is climbed, or pressed down by ends that lead and are forced
back and down: thin things are pushed by ends that trail. Thick ones are pressed down by what leans over them; up the
side of a dome such a hand slides, and flings it.
"""
SCORE = 0.9
"""Less with a turn, and with a lean, ..."""
SEVERAL = 0.05
"""... and only this share where several things touch: one of them would be pushed off the table, ..."""
VESSEL = 0.001
"""... and hardly any of a vessel, for its rim can be grasped."""


@dataclass(frozen=True)
class PushSettings:
    """Where things may stick out over the edge: y between which their middles are pushed there [m]."""

    free: tuple[float, float] = (-np.inf, np.inf)
    turning: tuple[float, float] = (-np.inf, np.inf)
    """The same of domes: the arm needs more room to turn them over."""


class Push:
    """Proposes pushes of wide things towards the table's edge."""

    name = "push"

    def __init__(self, settings: PushSettings = PushSettings()):
        """`settings`: where to."""
        self.settings = settings

    def __call__(self, scene: Scene) -> GraspSet:
        """Candidates in the frame *table*; none where the hand can have all, or no edge is known."""
        return scene.once(self._found)

    def _found(self, scene: Scene) -> GraspSet:
        if scene.edge is None or not PUSHING:
            return GraspSet.empty()
        with scene.clock(self.name):
            return pushes(scene.field, scene.edge, self.settings, scene.request.failed)


def pushes(
    field: HeightField,
    edge: float,
    settings: PushSettings = PushSettings(),
    failed: ArrayLike = (),
) -> GraspSet:
    """Candidates of every thing that is too wide for the hand, or that a grasp has failed on; frame *table*.

    Args:
        field: what stands there.
        edge: the table is where x is larger [m].
        settings: where to.
        failed: (F, 4, 4) poses of `hand_tcp` that were tried in vain.
    """
    tried = set(field.nearest(np.reshape(failed, (-1, 4, 4))[:, :3, 3], NEAR).tolist())
    things, found = field.separated.owner, list[GraspSet | None]()
    for number, shape in field.shapes.items():
        if number not in tried and shape.width <= level_pinch.BROADEST:
            continue
        thing = thing_to_move(field, shape, edge, settings)
        if thing is None or not (
            number in tried or shape.width > HAND.grasp.widest or thing.thickness < level_pinch.HEIGHT
        ):
            continue
        # What is low cannot be pinched level across more than `BROADEST`; other things, more than the hand is wide.
        share = SEVERAL if len(np.unique(things[tuple(shape.cells.T)])) > 1 else 1.0
        share *= VESSEL if shape.vessel else 1.0
        around = (
            way
            for way in along_the_edge(thing)
            if is_free(field, thing.others, thing.outline, way.direction * way.length)
        )
        ways = [*towards_the_edge(thing), *islice(around, AROUND)]
        ways = [way._replace(score=share * way.score) for way in ways]
        stances = product(ways, GAPS, LEANS)
        found += [push_of(field, thing, way, gap, lean) for way, gap, lean in stances]
    return joined([push for push in found if push is not None])


class Thing(NamedTuple):
    """What is pushed, a shape or a part of it. Lengths in metres.

    Attributes:
        points: (N, 2) its cells, outline: (M, 3) those at its border, middle: (2,) its centre of mass.
        thickness: of the thing.
        needed: how far it has to come nearer to the edge.
        others: (X, Y) height of all else within `APART` of every cell.
        free: y between which its middle may be at the edge.
        dome: whether it rises from its rim.
    """

    points: Array
    outline: Array
    middle: Array
    thickness: float
    needed: float
    others: Floats
    free: tuple[float, float] = (-np.inf, np.inf)
    dome: bool = False


class Way(NamedTuple):
    """Of a thing: direction (3,), a level unit vector; length [m]; score of an upright hand with the wider gap."""

    direction: Array
    length: float
    score: float


def thing_to_move(field: HeightField, shape: Shape, edge: float, settings: PushSettings) -> Thing | None:
    """None where there is nothing to push: it sticks out enough, or could not be pinched then."""
    points, middle, dome = shape.points, shape.centre_of_mass, edge_pinch.is_dome(shape)
    front = near_side(points, np.array([1.0, 0.0]), middle, HAND.ball_radius)
    if front is None or shape.thickness > (DOME if dome else edge_pinch.HEIGHT):
        return None
    front += middle[0]
    needed = min(front - edge + OVERHANG, float(middle[0]) - edge - edge_pinch.balance(shape))
    if (front < edge - ENOUGH and not dome) or needed < LEAST:
        return None
    own = field.owner == shape.number
    outline = np.insert(field.middles(np.argwhere(own & ~binary_erosion(own))), 2, 0.0, axis=1)
    others, free = heights_beside(field, shape), settings.turning if dome else settings.free
    return Thing(points, outline, middle, shape.thickness, needed, others, free, dome)


def heights_beside(field: HeightField, shape: Shape, apart: float = APART) -> Floats:
    """(X, Y) height of all else within `apart` [m] of every cell, less splinters of the same thing."""
    cells = np.bincount(field.owner.ravel())
    own = np.isin(field.things, field.things[tuple(shape.cells.T)])
    own &= cells[field.owner] < SPLINTER * len(shape.cells)
    own |= field.owner == shape.number
    others = np.where((field.owner > 0) & ~own, field.heights, np.float32(NOTHING))
    return maximum_filter(others, size=2 * int(apart / CELL) + 1, mode="constant", cval=NOTHING)


def towards_the_edge(thing: Thing) -> Iterator[Way]:
    """Ways of a thing to where it sticks out far enough and the edge is free, straight ones first."""
    for turn in TURNS:
        direction = -np.array([np.cos(turn), np.sin(turn), 0.0])
        way = (thing.needed - SHORT * abs(np.tan(turn))) / np.cos(turn)
        ends = thing.middle[1] + way * direction[1]
        if way >= LEAST and thing.free[0] < ends < thing.free[1]:
            yield Way(direction, way, SCORE * (1 - abs(turn) / np.pi))


def along_the_edge(thing: Thing) -> Iterator[Way]:
    """Of a thing that does not lie where the edge is free: all the way first, straight, then around things."""
    (x, y), (low, high) = thing.middle.tolist(), thing.free
    if low < y < high or low >= high:
        return
    inside = min(INSIDE, (high - low) / 2)
    wanted = float(np.clip(y, low + inside, high - inside))
    for share, turn in product((1.0, 0.5, 0.25), DETOURS):
        direction = np.array([np.sin(turn), np.sign(wanted - y) * np.cos(turn), 0.0])
        way = share * abs(wanted - y) / np.cos(turn)
        if abs(x + way * direction[0]) <= max(abs(x), OUTSIDE):
            yield Way(direction, way, ASIDE * (1 + share) / 2 * (1 - abs(turn) / np.pi))


def push_of(
    field: HeightField,
    thing: Thing,
    way: Way,
    gap: float,
    lean: float,
    apart: float = APART,
) -> GraspSet | None:
    """The push of one thing in one direction; None where something else is in the way.

    Args:
        field: where it lies.
        thing: what is pushed, way: where to.
        gap: between the fingers and the thing before [m].
        lean: of the hand, ahead over the thing [rad]; 0 = as it stands best.
        apart: from other things, of what moves [m].
    """
    direction, shape = way.direction, _pushing_hand()
    stand = next(angle for thickest, angle in STANDS if thing.thickness <= thickest)
    axes = _axes(*direction[:2].tolist(), lean or (max(stand, 0.0) if thing.dome else stand))
    hand, balls = shape.spheres @ axes.T, shape.balls @ axes.T
    # Across the way the two balls stand on both sides of the thing's middle, and meet its far side there.
    middle = balls[:, :2].mean(axis=0)
    if np.ptp(thing.points @ (-direction[1], direction[0])) < np.linalg.norm(balls[1, :2] - balls[0, :2]):
        return None  # it slips through between them
    sides = [
        near_side(
            thing.points, direction[:2], thing.middle + ball - middle, HAND.ball_radius, FIRST, ball=True
        )
        for ball in balls[:, :2]
    ]
    met = [side for side in sides if side is not None]
    if not met or way.length > LONGEST:
        return None
    lowest = (hand[..., 2] - HAND.sphere_radii).min()
    # How far the backs of the fingers are ahead of their ends, up to the thing's height.
    above = np.maximum(hand[PUSHING, :, 2] - lowest + CLEARANCE - thing.thickness, 0.0)
    reach = np.sqrt(np.maximum(HAND.sphere_radii**2 - above**2, 0.0))
    fronts = np.where(above < HAND.sphere_radii, hand[PUSHING, :] @ direction + reach, -np.inf)
    if not np.isfinite(fronts.max()):
        return None  # a hand that leans so far reaches over it
    ahead = float(fronts.max() - middle @ direction[:2])
    start = thing.middle + (min(met) - gap - ahead) * direction[:2]
    place = np.array([*(start - middle), CLEARANCE - lowest])
    palm = shape.palm @ axes.T + place
    if (field.top(palm) > palm[:, 2] - PALM).any():
        return None
    motion = (gap + float(np.mean(met)) - min(met) + way.length) * direction
    bottoms = (hand + place).reshape(-1, 3) - np.outer(HAND.all_radii, (0.0, 0.0, 1.0))
    moving = np.concatenate([thing.outline, bottoms])
    if not is_free(field, thing.others, moving, motion, apart):
        return None
    return GraspSet.of(
        Push.name,
        position=place,
        rotation=axes,
        pre_grasp_joints=shape.joints,
        grasp_joints=shape.joints,
        active_fingers=False,
        score=way.score * (NARROW if gap == GAPS[-1] else 1.0) * (1 - lean / np.pi),
        reference_point=[*thing.middle, thing.thickness],
        motion=motion,
    )


class _Hand(NamedTuple):
    """The hand that pushes, in the frame `hand_tcp`: joints (J,), spheres (F, S, 3), end balls of the two (2, 3), and
    places of its palm (P, 3).
    """

    joints: Array
    spheres: Array
    balls: Array
    palm: Array


@cache
def _pushing_hand() -> _Hand:
    joints = HAND.split(HAND.straight).copy()
    joints[:, 1] = _BEND
    joints = HAND.expand(HAND.reduce(joints.reshape(HAND.joint_count)))
    balls = HAND.end_balls(joints)[list(PUSHING)]
    return _Hand(joints, HAND.finger_spheres(joints), balls, HAND.palm_points())


@lru_cache(maxsize=256)
def _axes(dx: float, dy: float, lean: float) -> Array:
    """(3, 3) of a hand whose fingers point down, backs ahead in the direction (dx, dy), the two pushing balls level.

    With a `lean` [rad] its wrist is ahead of them, with a negative one behind.
    """
    direction = np.array([dx, dy, 0.0])
    y, z = np.diff(_pushing_hand().balls, axis=0)[0, 1:]
    cos, sin = np.array([-y, z]) / np.hypot(y, z)
    down = np.array([0.0, 0.0, -1.0])
    upright = np.stack([-direction, np.cross(down, -direction), down], axis=-1)
    level = upright @ np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    return Rotation.from_rotvec(lean * np.cross((0.0, 0.0, 1.0), direction)).as_matrix() @ level


def is_free(field: HeightField, others: Floats, moving: Array, motion: Array, step: float = APART) -> bool:
    """Whether points (N, 3) of thing and hand stay above `others` (X, Y) on their way, looked at every `step` [m]."""
    shares = np.linspace(0.0, 1.0, int(np.linalg.norm(motion) / step) + 2)
    low = moving[moving[:, 2] < others.max()].T
    there = low[:2, None] + motion[:2, None, None] * shares[:, None]  # coordinates contiguous in memory each
    return not (others.ravel()[field.cells(there.transpose(1, 2, 0))] > low[2]).any()
