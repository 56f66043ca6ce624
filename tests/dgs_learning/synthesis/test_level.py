"""Level pinches of the grasp synthesis: of what rests low only, above the table, held, and with their own pre-grasp."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_description.hand import HAND
from dgs_grasp_planner.contact.closing import posed
from dgs_learning.dataset import LEVEL, load_dataset, save_dataset
from dgs_learning.objects import shapes
from dgs_learning.synthesis.generate import packed
from dgs_learning.synthesis.level import MOST_RAISED, raised, sample_level
from dgs_learning.synthesis.sdf import signed_distance
from dgs_learning.synthesis.stage_one import ObjectGrasps, synthesise_chunk
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts

UP = np.array([1.0, 0.0, 0.0])
"""The rod's axis is z: it lies."""


@pytest.fixture(scope="module")
def rod() -> ObjectModel:
    return from_parts("rod", "stick", "rod", shapes.lathe([(0.013, -0.07), (0.013, 0.07)], sectors=14), 0.1)


@pytest.fixture(scope="module")
def found(rod: ObjectModel) -> ObjectGrasps:
    return synthesise_chunk(rod, signed_distance(rod), UP[None], [5, 0], draws=200, max_trials=8)


def above_table(position: np.ndarray, rotation: np.ndarray, joints: np.ndarray, support: float) -> np.ndarray:
    spheres = posed(HAND.finger_spheres(joints), position, rotation)
    return (spheres @ UP - HAND.sphere_radii).min(axis=(1, 2)) - support


def test_balls_are_level_beside_what_is_low_and_high_things_are_left_out(rod, block, sdf) -> None:
    drawn = sample_level(np.random.default_rng(0), rod, signed_distance(rod), 200, UP)
    grasps = drawn.grasps
    assert len(drawn) > 50 and (grasps.source == LEVEL).all()
    balls = posed(HAND.end_balls(grasps.pre_grasp_joints), grasps.position, grasps.rotation)[:, :4] @ UP
    assert np.quantile(np.ptp(balls, axis=1), 0.9) < 0.004
    low = above_table(grasps.position, grasps.rotation, grasps.pre_grasp_joints, drawn.support[0])
    assert low.min() > -0.003 and np.median(low) < 0.005
    assert not len(sample_level(np.random.default_rng(0), block, sdf, 200, UP))


def test_low_things_get_grasps_that_hold_above_the_table_with_a_pre_grasp_of_their_own(rod, found) -> None:
    level = found.grasps[found.grasps.source == LEVEL]
    assert len(level) >= 4, "nothing else reaches the sides of a rod of 26 mm that lies"
    equation = HAND.pre_grasp(level.grasp_joints, level.active_fingers).reshape(-1, HAND.joint_count)
    assert np.abs(level.pre_grasp_joints - equation).max(axis=1).min() > 0.1
    support = float((rod.vertices @ UP).min())
    for joints in (level.pre_grasp_joints, level.grasp_joints):
        assert above_table(level.position, level.rotation, joints, support).min() > -1e-6


def test_what_slid_up_is_raised_but_not_far(rod) -> None:
    drawn = sample_level(np.random.default_rng(0), rod, signed_distance(rod), 20, UP)
    grasps = raised(drawn).grasps
    for sunk in (0.002, 0.02):
        lower = replace(drawn, grasps=replace(grasps, position=grasps.position - sunk * UP))
        again = raised(lower).grasps
        gained = (again.position - lower.grasps.position) @ UP
        assert 0.0 < gained.max() <= MOST_RAISED + 1e-9
        low = above_table(again.position, again.rotation, again.pre_grasp_joints, drawn.support[0])
        assert (low.min() > 0) == (sunk < MOST_RAISED)


def test_their_pre_grasp_survives_the_file(rod, found, tmp_path: Path) -> None:
    data = packed([rod], [found])
    save_dataset(tmp_path / "d.npz", data)
    read = load_dataset(tmp_path / "d.npz")
    assert np.array_equal(read.grasps.source, data.grasps.source) and (read.grasps.source == LEVEL).any()
    assert np.array_equal(read.grasps.active_fingers, data.grasps.active_fingers)
    own = data.grasps.source == LEVEL
    assert np.abs(read.grasps.pre_grasp_joints - data.grasps.pre_grasp_joints)[own].max() < 0.004
