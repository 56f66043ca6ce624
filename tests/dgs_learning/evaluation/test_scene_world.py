"""The judge itself: the same hand around a block, and 15 cm beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_description.frames import transform
from dgs_learning.evaluation.proposers.top_down import TopDown
from dgs_learning.evaluation.scene_world import Outcome, SceneWorld
from dgs_learning.synthesis.scenes import Scene
from dgs_learning.training.views import ViewSettings, capture
from tests.dgs_learning.evaluation.proposers.test_proposers import BLOCK, scene_of


def test_a_block_is_lifted_by_a_good_grasp_and_missed_by_a_far_one() -> None:
    pose = transform(position=(0, 0, 0.036))
    view = capture([BLOCK], [pose], np.random.default_rng(0), ViewSettings())
    best = TopDown()(scene_of(view))[0]
    with SceneWorld([BLOCK], Scene(np.array([0]), pose[None])) as world:
        missed = world.execute(replace(best, position=best.position + [0.15, 0, 0]))
        good = world.execute(best)
    assert missed.outcome is Outcome.MISSED
    assert good.outcome is Outcome.SUCCESS
    assert good.object_index == 0
    assert np.allclose(good.closed.T_table_tcp, best.pose, atol=2e-3)
    assert good.closed.objects[0][2, 3] == pytest.approx(0.036, abs=0.02)
