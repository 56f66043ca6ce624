"""A block, its signed distance and a chunk of validated grasps: made once for all tests of the synthesis."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_learning.objects import shapes
from dgs_learning.synthesis.sdf import SignedDistance, signed_distance
from dgs_learning.synthesis.stage_one import ObjectGrasps, resting_ups, synthesise_chunk
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts


@pytest.fixture(scope="session")
def block() -> ObjectModel:
    return from_parts("block", "cuboid", "block", shapes.box([0.05, 0.06, 0.08]), 0.2)


@pytest.fixture(scope="session")
def sdf(block: ObjectModel) -> SignedDistance:
    return signed_distance(block)


@pytest.fixture(scope="session")
def ups(block: ObjectModel) -> np.ndarray:
    return resting_ups(block, 0)


@pytest.fixture(scope="session")
def found(block: ObjectModel, sdf: SignedDistance, ups: np.ndarray) -> ObjectGrasps:
    return synthesise_chunk(block, sdf, ups, [3, 0], draws=200, max_trials=8)
