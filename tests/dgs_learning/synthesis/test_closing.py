"""Closing onto a known object: fingers end on its surface, and what does not oppose is left out."""

from __future__ import annotations

import numpy as np

from dgs_description.hand import HAND
from dgs_learning.dataset import TOUCHING
from dgs_learning.synthesis.candidates import sample_guided
from dgs_learning.synthesis.closing import close, opposes
from dgs_learning.synthesis.sdf import SignedDistance
from dgs_learning.synthesis.stage_one import PINCH_OFFSET
from dgs_sim_bridge.render.object_model import ObjectModel


def test_fingers_end_on_the_surface(block: ObjectModel, sdf: SignedDistance, ups: np.ndarray) -> None:
    hands = sample_guided(np.random.default_rng(0), block, sdf, 100, 3, ups)
    closure = close(hands, sdf)
    met = closure.met
    assert 0 < met.sum() < met.size and not met[:, 3:].any(), "idle fingers touch nothing"
    assert np.abs(sdf(closure.point[met])).max() < 2 * TOUCHING
    np.testing.assert_allclose(np.linalg.norm(closure.normal[met], axis=-1), 1.0, atol=1e-6)
    start, target = (HAND.split(q) for q in (hands.grasps.pre_grasp_joints, hands.grasps.grasp_joints))
    low, high = np.minimum(start, target) - 1e-9, np.maximum(start, target) + 1e-9
    assert ((closure.joints >= low) & (closure.joints <= high)).all()
    np.testing.assert_array_equal(closure.joints[:, 3:], target[:, 3:])


def test_opposition_needs_the_thumb_and_its_partners(
    block: ObjectModel, sdf: SignedDistance, ups: np.ndarray
) -> None:
    hands = sample_guided(np.random.default_rng(0), block, sdf, 100, 5, ups)
    closure, active = close(hands, sdf), hands.grasps.active_fingers
    good = opposes(closure, active, max_offset=PINCH_OFFSET)
    assert 0 < good.sum() < len(good)
    assert closure.met[good, 0].all() and (closure.met[good, 1:].sum(axis=1) >= 2).all()
    assert not opposes(closure, active, max_offset=0.0).any()
