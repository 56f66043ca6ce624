"""Stage 1: validated grasps of single objects, in chunks that give the same in any order on any number of workers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from joblib import Memory

from dgs_description.frames import Array, transform
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_description.stage_clock import StageClock
from dgs_grasp_planner.contact.closing import posed
from dgs_learning.dataset import FARTHEST, LEVEL, UNIFORM, VARIED
from dgs_learning.objects.symmetry import symmetries_of
from dgs_learning.synthesis.candidates import (
    Candidates,
    concatenate,
    sample_guided,
    sample_near,
    sample_uniform,
)
from dgs_learning.synthesis.closing import approach_is_free, close, opposes
from dgs_learning.synthesis.level import raised, sample_level
from dgs_learning.synthesis.sdf import SignedDistance, signed_distance
from dgs_learning.synthesis.trial import Closed, FloatingHand
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.engines import ENGINES
from dgs_sim_bridge.world.scenes import SettlingTable

MAX_PENETRATION = 0.002
DROPS = 12
"""Times that an object is dropped to find its resting poses."""
MAX_RESTING_POSES = 8
SAME_UP = 0.996
"""Cosine of the angle below which two resting poses are the same (5 degrees)."""
MAX_NEIGHBOUR_OVERLAP = 0.002
"""[m]"""
MAX_COUPLING_ERROR = 0.1
"""Largest accepted difference of theta4 and theta3 after closing [rad]."""
PINCH_OFFSET, RIM_OFFSET = 0.03, 0.075
"""How far the pinch line may pass the centre of mass, for solids and for vessels [m]."""
DRAWS = {"bowl": 1600, "other": 400}
"""Candidates drawn per chunk: a bowl accepts a quarter of a per cent."""
BATCHES = 4
"""A chunk's candidates are drawn in so many parts, until enough of them are promising."""
FRICTIONS = (0.3, 0.4, 0.5)
"""A grasp is kept if it holds at one of them in the second engine; the lowest is recorded."""
VARIATIONS_PER_TRIAL = 4
"""Variations drawn per simulated one: a quarter to a half are promising."""
USUALLY_HELD, FEWEST_VARIED = 0.8, 8
"""Share of the simulated variations that hold, and how many a chunk simulates at least."""
FIRST_VARIED = 100_000
"""Number of the first chunk of variations in the seeds: those of `synthesise` stay below."""
PATTERN_SHARES = {5: 0.80, 3: 0.14, 2: 0.06}
"""Share of candidates per number of fingers."""
UNIFORM_SHARE = 0.1
"""Share of candidates drawn as the paper draws."""


@dataclass(frozen=True)
class ObjectGrasps:
    """Validated grasps of one object in its frame.

    Attributes:
        grasps: with joint4 = joint3; `source` is one of `dataset.SOURCES`.
        friction: (G,) lowest of `FRICTIONS` at which a grasp holds in the second engine.
        drawn, trials: candidates drawn, and those of them that were simulated.
    """

    grasps: GraspSet
    friction: Array
    drawn: int
    trials: int


def resting_ups(model: ObjectModel, seed: int) -> Array:
    """(M, 3) directions of the object's frame that point up in poses it comes to rest in, found by dropping it.

    Of poses that a symmetry of the object maps onto each other only one is kept: its grasps serve them all. More than
    `MAX_RESTING_POSES` are not needed.
    """
    rng = np.random.default_rng(seed)
    turns = symmetries_of(model)
    ups: list[Array] = []
    height = float(np.linalg.norm(model.vertices, axis=1).max()) + 0.005
    with SettlingTable() as table:
        for k in range(DROPS):
            rotation = np.eye(3) if k == 0 else _random_rotation(rng)
            table.add(model, transform(rotation, (0, 0, height)))
            table.step(240)
            up = table.poses()[0, 2, :3]
            if all((turns @ up @ known).max() < SAME_UP for known in ups):
                ups.append(up)
            table.bullet.removeBody(table.bodies.pop())
    return np.array(ups[:MAX_RESTING_POSES])


def _random_rotation(rng: np.random.Generator) -> Array:
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def _draw(
    rng: np.random.Generator,
    model: ObjectModel,
    sdf: SignedDistance,
    ups: Array,
    count: int,
) -> Candidates:
    groups = []
    for fingers, share in PATTERN_SHARES.items():
        total = round(count * share)
        plain = round(total * UNIFORM_SHARE)
        groups.append(sample_uniform(rng, model, plain, fingers))
        groups.append(sample_guided(rng, model, sdf, total - plain, fingers, ups))
    groups += [sample_level(rng, model, sdf, count // len(ups), up) for up in ups]
    return concatenate(groups)


def _promising(hands: Candidates, sdf: SignedDistance, max_offset: float) -> Candidates:
    """Those that pass every kinematic test, with pre-grasp and contact posture."""
    hands = hands[approach_is_free(hands, sdf)]
    closure = close(hands, sdf)
    good = opposes(closure, hands.grasps.active_fingers, max_offset)
    # A uniform draw is kept without the quality filter, so that the support of the data is not ours but the paper's.
    good |= (hands.grasps.source == UNIFORM) & closure.met[:, 0] & (closure.met.sum(1) >= 2)
    hands = hands.closed(closure.joints)[good]
    return hands[approach_is_free(hands, sdf)]


def _measured(hand: Candidates, closed: Closed) -> Candidates:
    """One candidate as it closed: what is stored. Coupled joints take their mean."""
    joints = HAND.split(HAND.settled(closed.joints[None]))
    position, rotation = closed.T_object_tcp[None, :3, 3], closed.T_object_tcp[None, :3, :3]
    grasps = replace(hand.grasps, position=position, rotation=rotation, reference_point=position)
    measured = replace(hand, grasps=grasps).closed(joints)
    return raised(measured) if hand.grasps.source[0] == LEVEL else measured


def _is_sound(hand: Candidates, sdf: SignedDistance) -> bool:
    """Whether the stored numbers themselves describe a sound grasp.

    Not too far away for the file, little penetration, fingers apart, approach free.
    """
    grasps = hand.grasps
    if np.abs(grasps.position).max() > FARTHEST:
        return False
    spheres = HAND.finger_spheres(grasps.grasp_joints)
    if sdf.clearance(posed(spheres, grasps.position, grasps.rotation)).min() < -MAX_PENETRATION:
        return False
    between = np.linalg.norm(spheres[0, 1:-1, :, None] - spheres[0, 2:, None], axis=-1)
    gap = between - HAND.sphere_radii[:, None] - HAND.sphere_radii
    # The capsules are 1.5 mm fatter than the shells between neighbours (docs/hand.md).
    if gap.min(initial=np.inf) + 0.003 < -MAX_NEIGHBOUR_OVERLAP:
        return False
    return bool(approach_is_free(hand, sdf)[0])


def _held(hand: FloatingHand, one: Candidates, sdf: SignedDistance, clock: StageClock) -> GraspSet | None:
    """One candidate in physics: the grasp as it closed, None if it does not hold.

    What was measured is judged before the six-axis test, which is most of a trial's cost.
    """
    with clock("closing"):
        closed = hand.close(one.grasps[0])
    if not closed.touching:
        return None
    with clock("recheck"):
        measured = _measured(one, closed)
        off = np.abs(closed.joints - HAND.settled(closed.joints)).max()
        sound = 2 * off <= MAX_COUPLING_ERROR and _is_sound(measured, sdf)
    if not sound:
        return None
    with clock("gravity"):
        return measured.grasps if hand.shake() else None


def lowest_friction(hand: FloatingHand, grasp: GraspSet) -> float:
    """Lowest of `FRICTIONS` at which a grasp, closed anew, holds; infinite where it holds at none."""
    for friction in FRICTIONS:
        hand.world.set_friction(friction)
        if hand.close(grasp).touching and hand.shake():
            return friction
    return np.inf


def synthesise_chunk(
    model: ObjectModel,
    sdf: SignedDistance,
    ups: Array,
    seed: Sequence[int],
    draws: int,
    max_trials: int,
    clock: StageClock | None = None,
) -> ObjectGrasps:
    """Draw, filter and simulate one chunk of candidates in a world of its own.

    Args:
        model: the object, sdf: its signed distance.
        ups: (M, 3) its resting directions that are approached.
        seed: key of the chunk; the same key gives the same grasps whatever ran before.
        draws: candidates drawn, at most: in batches, until `max_trials` are promising.
        max_trials: at most so many of the promising ones are simulated.
        clock: measures the stages.
    """
    clock = clock or StageClock(time.process_time)
    rng = np.random.default_rng(seed)
    groups: list[Candidates] = []
    drawn = 0
    while drawn < draws and sum(map(len, groups)) < max_trials:
        count = min(-(-draws // BATCHES), draws - drawn)
        with clock("draw"):
            batch = _draw(rng, model, sdf, ups, count)
        with clock("kinematics"):
            groups.append(_promising(batch, sdf, _max_offset(model)))
        drawn += count
    hands = concatenate(groups)
    return _simulated(model, hands[rng.permutation(len(hands))[:max_trials]], sdf, drawn, clock)


def vary_chunk(
    model: ObjectModel, sdf: SignedDistance, ups: Array, known: GraspSet, seed: Sequence[int], max_trials: int
) -> ObjectGrasps:
    """Variations of grasps that hold, filtered and simulated as those of `synthesise_chunk`."""
    rng = np.random.default_rng(seed)
    drawn = VARIATIONS_PER_TRIAL * max_trials
    hands = _promising(sample_near(rng, model, known, drawn, ups), sdf, _max_offset(model))[:max_trials]
    return _simulated(model, hands, sdf, drawn, StageClock(time.process_time))


def _max_offset(model: ObjectModel) -> float:
    return RIM_OFFSET if model.shape_class == "bowl" else PINCH_OFFSET


def _simulated(
    model: ObjectModel, hands: Candidates, sdf: SignedDistance, drawn: int, clock: StageClock
) -> ObjectGrasps:
    """Those of the hands that hold in both engines, in one world each."""
    if not len(hands):
        return ObjectGrasps(GraspSet.empty(), np.zeros(0), drawn, 0)
    with clock("world"):
        first, second = (FloatingHand(model, engine) for engine in ENGINES)
    kept, friction = [], []
    with first, second:
        for i in range(len(hands)):
            held = _held(first, hands[i : i + 1], sdf, clock)
            if held is None:
                continue
            with clock("second engine"):
                lowest = lowest_friction(second, held[0])
            if np.isfinite(lowest):
                kept.append(held)
                friction.append(lowest)
    return ObjectGrasps(joined(kept), np.array(friction), drawn, len(hands))


@dataclass(frozen=True)
class Effort:
    """When an object at one scale is done.

    Attributes:
        target: grasps wanted.
        max_chunks: chunks of draws per resting pose after which it is done all the same.
        per_pose: grasps wanted of every resting pose at least, however many poses share the target.
        draws: candidates drawn per chunk; None = `DRAWS` of the shape class.
        varied: grasps wanted of `vary`, those that were known included.
    """

    target: int
    max_chunks: int
    per_pose: int = 4
    draws: int | None = None
    varied: int = 0


def synthesise(
    model: ObjectModel, seed: Sequence[int], effort: Effort, chunks: Path | None = None
) -> ObjectGrasps:
    """Chunks of one object until every resting pose has its share of the target, or as many chunks as are allowed.

    Each chunk approaches one resting pose, so that poses which are hard to grasp are not drowned by the easy ones. A
    chunk, not a trial, is what a killed run finds again: the trials of a chunk share one world, whose state (contact
    caches) outlives each trial, so a chunk that goes on in a new world would give other grasps.

    Args:
        model: the object at one scale.
        seed: key of the object and scale.
        effort: when it is done.
        chunks: finished chunks are kept in this folder, and those of a run that was cut short are taken from it.
    """
    sdf = signed_distance(model)
    ups = resting_ups(model, seed[0])
    draws = effort.draws or DRAWS.get(model.shape_class, DRAWS["other"])
    share = max(effort.per_pose, round(effort.target / len(ups)))
    make = Memory(chunks, verbose=0).cache(synthesise_chunk, ignore=["sdf", "clock"])
    done: list[ObjectGrasps] = []
    for pose, up in enumerate(ups):
        made = 0
        for turn in range(effort.max_chunks):
            key = [*seed, pose * effort.max_chunks + turn]
            done.append(make(model, sdf, up[None], key, draws, max_trials=2 * share))
            made += len(done[-1].grasps)
            if made >= share:
                break
    return _together(done)


def vary(
    model: ObjectModel, known: ObjectGrasps, seed: Sequence[int], effort: Effort, chunks: Path | None = None
) -> ObjectGrasps:
    """Known grasps and variations of them, `effort.varied` in all or as many as `effort.max_chunks` chunks give.

    Variations are not varied again, so that none strays; those of level pinches are not told from them. Other
    arguments as for `synthesise`.
    """
    parents = known.grasps[known.grasps.source != VARIED]
    sdf = signed_distance(model)
    ups = resting_ups(model, seed[0])
    make = Memory(chunks, verbose=0).cache(vary_chunk, ignore=["sdf"])
    found = known
    for _ in range(effort.max_chunks if len(parents) else 0):
        lacking = effort.varied - len(found.grasps)
        if lacking <= 0:
            break
        key = [*seed, FIRST_VARIED + found.drawn]  # of no chunk before: each draws some
        trials = max(FEWEST_VARIED, round(lacking / USUALLY_HELD))
        chunk = make(model, sdf, ups, parents, key, trials)
        found = _together([found, chunk])
    return found


def _together(parts: Sequence[ObjectGrasps]) -> ObjectGrasps:
    return ObjectGrasps(
        joined([part.grasps for part in parts]),
        np.concatenate([part.friction for part in parts]),
        sum(part.drawn for part in parts),
        sum(part.trials for part in parts),
    )
