"""Chunks of validated grasps: reproducible, no more trials than asked for, and sound."""

from __future__ import annotations

import numpy as np

from dgs_description.hand import HAND
from dgs_grasp_planner.contact.closing import posed
from dgs_learning.dataset import FARTHEST, GUIDED, POSITION_STEP, VARIED
from dgs_learning.synthesis import stage_one
from dgs_learning.synthesis.candidates import sample_uniform
from dgs_learning.synthesis.closing import approach_is_free
from dgs_learning.synthesis.stage_one import MAX_PENETRATION, Effort, synthesise_chunk, vary
from dgs_learning.synthesis.trial import FloatingHand


def test_no_candidates_are_fine_everywhere(block, sdf, ups, monkeypatch):
    none = sample_uniform(np.random.default_rng(0), block, 0, 5)
    assert not len(approach_is_free(none, sdf))
    monkeypatch.setattr(stage_one, "UNIFORM_SHARE", 1.0)
    assert not len(synthesise_chunk(block, sdf, ups, [3, 9], draws=4, max_trials=2).grasps)


def test_no_more_are_drawn_than_are_simulated(block, sdf, ups):
    few, many = (synthesise_chunk(block, sdf, ups, [3, 1], draws=400, max_trials=n) for n in (1, 8))
    assert few.trials == 1 and many.trials == 8
    assert few.drawn < many.drawn <= 400


def test_chunk_gives_the_same_grasps_again(block, sdf, ups, found):
    again = synthesise_chunk(block, sdf, ups, [3, 0], draws=200, max_trials=8)
    assert len(found.grasps) >= 2 and (found.drawn, found.trials) == (again.drawn, again.trials)
    for name, values in vars(found.grasps).items():
        assert np.array_equal(values, getattr(again.grasps, name)), name


def test_variations_stay_near_what_they_vary_and_are_not_varied_again(block, found, tmp_path):
    wanted = len(found.grasps) + 3
    more = vary(block, found, [3, 0, 0], Effort(4, 2, varied=wanted), tmp_path)
    known, new = more.grasps[: len(found.grasps)], more.grasps[len(found.grasps) :]
    assert np.array_equal(known.position, found.grasps.position) and len(new) >= 3
    assert set(new.source) == {VARIED} and GUIDED in known.source and more.trials > found.trials
    way = np.linalg.norm(new.position[:, None] - known.position, axis=2).min(1)
    assert way.min() > 0 and way.max() < 0.03
    again = vary(block, more, [3, 0, 0], Effort(4, 2, varied=wanted + 3), tmp_path)
    newest = again.grasps[len(more.grasps) :]
    way = np.linalg.norm(newest.position[:, None] - more.grasps.position, axis=2)
    assert len(newest) >= 3 and way.min() > 1e-6, "the same ones were made again"
    assert way[:, : len(known)].min(1).max() < 0.03


def test_what_lies_too_far_away_for_the_file_is_not_sound(block, sdf):
    near, far = np.array([0.0, 0.0, FARTHEST]), np.array([0.0, 0.0, FARTHEST + POSITION_STEP])
    one = sample_uniform(np.random.default_rng(0), block, 1, 5)
    one.grasps.pre_grasp_joints[:] = one.grasps.grasp_joints[:] = HAND.open_hand
    for position, sound in ((near, True), (far, False)):
        one.grasps.position[:] = position
        assert stage_one._is_sound(one, sdf) == sound


def test_stored_grasps_are_sound_and_pass_again(block, sdf, found):
    grasps = found.grasps
    joints = HAND.split(grasps.grasp_joints)
    assert np.array_equal(joints[..., 2], joints[..., 3])
    spheres = posed(HAND.finger_spheres(joints), grasps.position, grasps.rotation)
    assert sdf.clearance(spheres).min() > -MAX_PENETRATION
    with FloatingHand(block) as world:
        held = [world.close(grasps[i]).touching and world.shake() for i in range(len(grasps))]
    assert np.mean(held) >= 0.75
