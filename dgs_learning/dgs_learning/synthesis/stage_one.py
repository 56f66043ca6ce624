"""Stage 1.

Dense validated grasps of single objects, in independent chunks that give the same result in any order on
any number of workers.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
import pybullet
from numpy.typing import NDArray

from dgs_description.frames import transform
from dgs_description.hand_model import SPHERE_RADII, finger_spheres, pre_grasp
from dgs_learning.objects.symmetry import symmetries
from dgs_learning.synthesis.candidates import Candidates, concatenate, sample_guided, sample_uniform
from dgs_learning.synthesis.clock import StageClock
from dgs_learning.synthesis.closing import approach_is_free, close, opened, opposes
from dgs_learning.synthesis.sdf import SignedDistance, signed_distance
from dgs_learning.synthesis.trial import FloatingHand, TrialResult
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.physics import add_object, body_pose, new_client

Array = NDArray[np.float64]

MAX_PENETRATION = 0.002
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
PATTERN_SHARES = {5: 0.80, 3: 0.14, 2: 0.06}
"""Share of candidates per number of fingers."""


@dataclass(frozen=True)
class GraspRecords:
    """G validated grasps of one object in its frame.

    Attributes:
        position: (G, 3) TCP [m], rotation: (G, 3, 3).
        joints: (G, 20) final joints with theta4 = theta3 [rad].
        fingers: (G,) 5, 3 or 2.
        uniform: (G,) drawn without guidance.
        trials: candidates that went into physics, drawn: candidates drawn, seconds: time spent.
    """

    position: Array
    rotation: Array
    joints: Array
    fingers: NDArray[np.int64]
    uniform: NDArray[np.bool_]
    drawn: int
    trials: int
    seconds: float

    def __len__(self) -> int:
        return len(self.position)


def join(groups: list[GraspRecords]) -> GraspRecords:
    """One set of several."""
    return GraspRecords(
        position=np.concatenate([g.position for g in groups]),
        rotation=np.concatenate([g.rotation for g in groups]),
        joints=np.concatenate([g.joints for g in groups]),
        fingers=np.concatenate([g.fingers for g in groups]),
        uniform=np.concatenate([g.uniform for g in groups]),
        drawn=sum(g.drawn for g in groups),
        trials=sum(g.trials for g in groups),
        seconds=sum(g.seconds for g in groups),
    )


def resting_ups(model: ObjectModel, seed: int, drops: int = 12) -> Array:
    """(M, 3) directions of the object's frame that point up in poses it comes to rest in, found by dropping it.

    Of poses that a symmetry of the object maps onto each other only one is kept: its grasps serve them all.
    """
    rng = np.random.default_rng(seed)
    turns = symmetries(model.family)
    client = new_client()
    try:
        pybullet.setGravity(0, 0, -9.81, physicsClientId=client)
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        pybullet.changeDynamics(
            pybullet.createMultiBody(0, plane, physicsClientId=client),
            -1,
            lateralFriction=0.8,
            physicsClientId=client,
        )
        ups: list[Array] = []
        height = float(np.linalg.norm(model.vertices, axis=1).max()) + 0.005
        for k in range(drops):
            rotation = np.eye(3) if k == 0 else _random_rotation(rng)
            body = add_object(client, model, transform(rotation, (0, 0, height)))
            for _ in range(240):
                pybullet.stepSimulation(physicsClientId=client)
            up = body_pose(client, body)[2, :3]
            if all((turns @ up @ known).max() < SAME_UP for known in ups):
                ups.append(up)
            pybullet.removeBody(body, physicsClientId=client)
        return np.array(ups)
    finally:
        pybullet.disconnect(physicsClientId=client)


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
    uniform_share: float,
) -> Candidates:
    groups = []
    for fingers, share in PATTERN_SHARES.items():
        total = round(count * share)
        plain = round(total * uniform_share)
        groups.append(sample_uniform(rng, model, plain, fingers))
        groups.append(sample_guided(rng, model, sdf, total - plain, fingers, ups))
    return concatenate(groups)


def _promising(
    candidates: Candidates, sdf: SignedDistance, max_offset: float
) -> tuple[Candidates, Array, Array]:
    """Candidates that pass every kinematic test, with pre-grasp and contact posture (N, 20)."""
    candidates = candidates[np.flatnonzero(approach_is_free(candidates, sdf, opened(candidates)))]
    closure = close(candidates, sdf, opened(candidates))
    fingers = candidates.active.sum(1)
    good = np.zeros(len(candidates), dtype=bool)
    for count in np.unique(fingers):
        good |= (fingers == count) & opposes(closure, int(count), max_offset)
    # A uniform draw is kept without the quality filter, so that the support of the data is not ours but the paper's.
    good |= candidates.uniform & closure.met[:, 0] & (closure.met.sum(1) >= 2)
    index = np.flatnonzero(good)
    candidates, joints = candidates[index], closure.joints[index]
    before = pre_grasp(joints, candidates.active)
    free = np.flatnonzero(approach_is_free(candidates, sdf, before))
    return candidates[free], before[free].reshape(-1, 20), joints[free].reshape(-1, 20)


def coupled(joints: Array) -> Array:
    """(20,) joints with theta3 and theta4 replaced by their mean: what the steel coupling allows."""
    q = np.array(joints, dtype=np.float64).reshape(5, 4)
    q[:, 2:] = q[:, 2:].mean(1, keepdims=True)
    return q.reshape(20)


def _acceptable(result: TrialResult, candidate: Candidates, sdf: SignedDistance) -> bool:
    """Whether the stored numbers themselves describe a sound grasp.

    Little penetration, coupled joints, fingers apart, approach free.
    """
    measured = result.joints.reshape(5, 4)
    if np.abs(measured[:, 3] - measured[:, 2]).max() > MAX_COUPLING_ERROR:
        return False
    joints = coupled(result.joints).reshape(1, 5, 4)
    moved = replace(
        candidate, position=result.T_object_tcp[None, :3, 3], rotation=result.T_object_tcp[None, :3, :3]
    )
    spheres = finger_spheres(joints)
    if (sdf(moved.to_object(spheres)) - SPHERE_RADII).min() < -MAX_PENETRATION:
        return False
    for a, b in zip(range(1, 4), range(2, 5), strict=True):
        gap = (
            np.linalg.norm(spheres[0, a][:, None] - spheres[0, b][None], axis=-1)
            - SPHERE_RADII[:, None]
            - SPHERE_RADII
        )
        # The capsules are 1.5 mm fatter than the shells between neighbours (docs/hand.md).
        if gap.min() + 0.003 < -MAX_NEIGHBOUR_OVERLAP:
            return False
    return bool(approach_is_free(moved, sdf, pre_grasp(joints, candidate.active))[0])


def _enough(
    rng: np.random.Generator,
    model: ObjectModel,
    sdf: SignedDistance,
    ups: Array,
    draws: int,
    wanted: int,
    uniform_share: float,
    clock: StageClock,
) -> tuple[Candidates, Array, Array, int]:
    """Promising candidates, drawn in batches until there are `wanted` or `draws` are drawn; and how many were drawn."""
    offset = RIM_OFFSET if model.shape_class == "bowl" else PINCH_OFFSET
    groups: list[tuple[Candidates, Array, Array]] = []
    drawn = found = 0
    while drawn < draws and found < wanted:
        count = min(-(-draws // BATCHES), draws - drawn)
        with clock("draw"):
            batch = _draw(rng, model, sdf, ups, count, uniform_share)
        with clock("kinematics"):
            groups.append(_promising(batch, sdf, offset))
        drawn += count
        found += len(groups[-1][0])
    candidates, before, contact = zip(*groups, strict=True)
    return concatenate(list(candidates)), np.concatenate(before), np.concatenate(contact), drawn


def _timed_acceptable(
    clock: StageClock, candidate: Candidates, sdf: SignedDistance, result: TrialResult
) -> bool:
    with clock("recheck"):
        return _acceptable(result, candidate, sdf)


def synthesise_chunk(
    model: ObjectModel,
    sdf: SignedDistance,
    ups: Array,
    seed: list[int],
    draws: int = 400,
    max_trials: int = 40,
    uniform_share: float = 0.1,
    clock: StageClock | None = None,
) -> GraspRecords:
    """Draw, filter and simulate one chunk of candidates in a world of its own.

    Args:
        seed: key of the chunk; the same key gives the same grasps whatever ran before.
        draws: candidates drawn, at most.
        max_trials: at most so many of the promising ones are simulated; with that many, no more are drawn.
        uniform_share: share drawn as the paper draws.
        clock: measures the stages.
    """
    clock = clock or StageClock()
    started = time.perf_counter()
    rng = np.random.default_rng(seed)
    candidates, before, contact, drawn = _enough(
        rng, model, sdf, ups, draws, max_trials, uniform_share, clock
    )
    order = rng.permutation(len(candidates))[:max_trials]
    kept: list[tuple[TrialResult, int]] = []
    if len(order):
        with clock("world"):
            world = FloatingHand(model, clock=clock)
        with world:
            for i in order:
                result = world.run(
                    candidates.position[i],
                    candidates.rotation[i],
                    before[i],
                    contact[i],
                    candidates.active[i],
                    accept=partial(_timed_acceptable, clock, candidates[i : i + 1], sdf),
                )
                if result.stable:
                    kept.append((result, i))
    poses = np.array([r.T_object_tcp for r, _ in kept]).reshape(-1, 4, 4)
    index = np.array([i for _, i in kept], dtype=int)
    return GraspRecords(
        position=poses[:, :3, 3],
        rotation=poses[:, :3, :3],
        joints=np.array([coupled(r.joints) for r, _ in kept]).reshape(-1, 20),
        fingers=candidates.active[index].sum(1),
        uniform=candidates.uniform[index],
        drawn=drawn,
        trials=len(order),
        seconds=time.perf_counter() - started,
    )


class Chunks(Protocol):
    """Where finished chunks of an object are kept, see `checkpoint.ChunkFolder`."""

    def load(self, key: Sequence[int], draws: int, trials: int) -> GraspRecords | None:
        """A finished chunk, or None."""

    def save(self, key: Sequence[int], draws: int, trials: int, records: GraspRecords) -> None:
        """Keep a finished chunk."""


@dataclass(frozen=True)
class Effort:
    """When an object at one scale is done.

    Attributes:
        target: grasps wanted.
        max_chunks: chunks of draws per resting pose after which it is done all the same.
        per_pose: grasps wanted of every resting pose at least, however many poses share the target.
        draws: candidates drawn per chunk; None = `DRAWS` of the shape class.
    """

    target: int
    max_chunks: int
    per_pose: int = 4
    draws: int | None = None


def synthesise(
    model: ObjectModel, seed: list[int], effort: Effort, chunks: Chunks | None = None
) -> GraspRecords:
    """Chunks of one object until every resting pose has its share of the target, or as many chunks as are allowed.

    Each chunk approaches one resting pose, so that poses which are hard to grasp are not drowned by the easy ones.

    Args:
        model: the object at one scale.
        seed: key of the object and scale.
        effort: when it is done.
        chunks: takes finished chunks and gives back those of a run that was cut short.
    """
    sdf = signed_distance(model)
    ups = resting_ups(model, seed[0])[:MAX_RESTING_POSES]
    draws = effort.draws or DRAWS.get(model.shape_class, DRAWS["other"])
    share = max(effort.per_pose, round(effort.target / len(ups)))
    groups = []
    for pose, up in enumerate(ups):
        made = 0
        for turn in range(effort.max_chunks):
            key = [*seed, pose * effort.max_chunks + turn]
            chunk = chunks.load(key, draws, 2 * share) if chunks else None
            if chunk is None:
                chunk = synthesise_chunk(model, sdf, up[None], key, draws, max_trials=2 * share)
                if chunks:
                    chunks.save(key, draws, 2 * share, chunk)
            groups.append(chunk)
            made += len(chunk)
            if made >= share:
                break
    return join(groups)
