"""Candidate level pinches of what lies low on a table: the stance of the planner's proposer, drawn at random."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_grasp_planner.contact.closing import posed
from dgs_grasp_planner.propose.level_stance import ACTIVE, hand_axes, level_stance
from dgs_learning.dataset import LEVEL
from dgs_learning.synthesis.candidates import Candidates, centred, inside_points
from dgs_learning.synthesis.sdf import SignedDistance
from dgs_sim_bridge.render.object_model import ObjectModel

LOW = 0.040
"""What rests lower than this is pinched level [m]."""
NARROW, WIDEST = 0.045, 0.075
"""Across the thing: up to the first any lean does, up to the second the first of `LEANS` [m]."""
LEANS = np.deg2rad([25.0, 30.0, 35.0])
ROOMS = np.array([0.006, 0.009, 0.012])
"""Of the hand [rad], and between balls and thing before they close [m]."""
CLEARANCE = 0.0005, 0.004
"""Of the balls above the table [m]."""
MOST_RAISED = 0.005
"""What slid up between the fingers while they closed is taken so much higher at most [m]."""
BITE = 0.005
"""So far into the thing the hand would close, so that each finger meets it [m]."""
OFF_SQUARE = np.deg2rad(10.0)
"""The line between thumb and fingers is turned from the surface's normal by this (standard deviation) [rad]."""


def sample_level(
    rng: np.random.Generator, model: ObjectModel, sdf: SignedDistance, count: int, up: Array
) -> Candidates:
    """Pinches with a pre-grasp of their own, for an object that rests with `up` (3,) upwards (object frame).

    Args:
        model: the object, sdf: its signed distance.
        count: places drawn; fewer candidates come back, none where the object is higher than `LOW`.
    """
    heights = model.vertices.astype(np.float64) @ up
    support = float(heights.min())
    if np.ptp(heights) > LOW or not ACTIVE.any():
        return Candidates(GraspSet.empty(), np.zeros((0, 3)), np.zeros(0))
    points = inside_points(rng, model, sdf, count)
    normal = sdf.normals(points)
    flat = normal - (normal @ up)[:, None] * up
    turn = Rotation.from_rotvec(rng.normal(0.0, OFF_SQUARE, count)[:, None] * up)
    across = turn.apply(flat * rng.choice([-1.0, 1.0], (count, 1)))
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    points, _ = centred(sdf, points, np.broadcast_to(up, points.shape))
    points, width = centred(sdf, points, across)
    keep = np.flatnonzero((np.linalg.norm(flat, axis=1) > 0.3) & (width < WIDEST))
    if not len(keep):
        return Candidates(GraspSet.empty(), np.zeros((0, 3)), np.zeros(0))
    points, across, width = points[keep], across[keep], width[keep]
    least = HAND.ball_radius + rng.uniform(*CLEARANCE, len(keep))
    points = points + np.maximum(least - (points @ up - support), 0.0)[:, None] * up
    lean = np.where(width > NARROW, LEANS[0], rng.choice(LEANS, len(keep)))
    room = rng.choice(ROOMS, len(keep))
    stances = [
        level_stance(w - 2 * BITE, a, r + BITE)
        for w, a, r in zip(width, lean.tolist(), room.tolist(), strict=True)
    ]
    axes = [hand_axes(a, -up, tilt) for a, tilt in zip(across, lean.tolist(), strict=True)]
    rotation = np.array(axes)
    middle = np.array([stance.middle for stance in stances])
    grasps = GraspSet.of(
        LEVEL,
        position=points - np.einsum("nij,nj->ni", rotation, middle),
        rotation=rotation,
        pre_grasp_joints=np.array([stance.before.reshape(HAND.joint_count) for stance in stances]),
        grasp_joints=np.array([stance.final.reshape(HAND.joint_count) for stance in stances]),
        active_fingers=ACTIVE,
    )
    return Candidates(grasps, np.broadcast_to(up, (len(keep), 3)), np.full(len(keep), support))


def raised(pinch: Candidates) -> Candidates:
    """The pinches moved up until they clear the table on which their object rests, by `MOST_RAISED` at most.

    Without a table a thing slides up between the balls while they close; what is stored is where the hand goes down
    to a thing that still lies there.
    """
    grasps = pinch.grasps
    lowest = np.full(len(grasps), np.inf)
    for joints in (grasps.pre_grasp_joints, grasps.grasp_joints):
        spheres = posed(HAND.finger_spheres(joints), grasps.position, grasps.rotation)
        lowest = np.minimum(
            lowest, (np.einsum("nfsi,ni->nfs", spheres, pinch.up) - HAND.sphere_radii).min(axis=(1, 2))
        )
    way = np.clip(pinch.support + CLEARANCE[0] - lowest, 0.0, MOST_RAISED)
    position = grasps.position + way[:, None] * pinch.up
    return replace(pinch, grasps=replace(grasps, position=position, reference_point=position))
