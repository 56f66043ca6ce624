"""What is trained on is what the network is given when it is used."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dgs_grasp_planner.network import PRESETS, DGSNet
from dgs_grasp_planner.network.input_frame import table_from_input
from dgs_grasp_planner.propose.dgs_net import DgsNet
from dgs_grasp_planner.scene import PlanRequest, prepare
from dgs_learning.training.batches import ViewDataset, make_batch
from dgs_learning.training.views import ViewSource
from tests.dgs_learning.tiny_dataset import tiny_dataset


@pytest.mark.parametrize("frame", ["table", "camera"])
def test_training_and_use_see_a_view_in_the_same_frame(frame: str) -> None:
    config = replace(PRESETS["tiny"], frame=frame, features=("ones", "xyz"))
    sample = ViewDataset(ViewSource(tiny_dataset(), 0), 0, augmented=True)[0, 0, 0]
    batch = make_batch([sample], config)
    scene = prepare(sample.view.points, sample.view.camera, np.random.default_rng(0), PlanRequest())
    scene = replace(scene, points=sample.view.points)
    T_table_input = table_from_input(frame, sample.view.camera)
    used = DgsNet(DGSNet(config))._batch(scene, T_table_input)
    np.testing.assert_allclose(batch.voxels.centres, used.centres, atol=1e-5)
    np.testing.assert_allclose(batch.voxels.features, used.features, atol=1e-4)
    # The labels' hands come from above.
    approach = T_table_input[:3, :3] @ batch.rotation.double().numpy()[:, :, 2].mean(axis=0)
    assert approach[2] < -0.3
