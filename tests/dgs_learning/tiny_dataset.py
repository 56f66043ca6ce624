"""Two objects, three scenes, a few grasps from above: enough to train on for some steps."""

from __future__ import annotations

import numpy as np

from dgs_description.frames import transform
from dgs_learning.dataset import GUIDED, UNIFORM, GraspDataset, SceneGrasps, finger_pattern, object_grasps
from dgs_learning.objects import shapes
from dgs_sim_bridge.render.object_model import from_parts


def tiny_dataset(scenes: int = 3) -> GraspDataset:
    """The same scene some times over."""
    rng = np.random.default_rng(0)
    models = [
        from_parts("block", "cuboid", "block", shapes.box([0.05, 0.06, 0.08]), 0.2),
        from_parts("can", "cylinder", "can", shapes.lathe([(0.03, 0), (0.03, 0.1)]), 0.2),
    ]
    down = np.diag([1.0, -1.0, -1.0])
    poses = np.array([transform(position=(-0.1, 0, 0.04)), transform(position=(0.1, 0.05, 0.05))])
    scene = SceneGrasps(
        np.array([0, 1]), poses, np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1]), np.array([0, 1, 0, 5])
    )
    joints = rng.uniform(0.1, 0.8, (4, 5, 4))
    joints[..., 0] = 0.0
    joints[..., 3] = joints[..., 2]
    return GraspDataset(
        objects=models,
        first=np.array([0, 2, 4]),
        grasps=object_grasps(
            rng.uniform(-0.01, 0.03, (4, 3)),
            np.tile(down, (4, 1, 1)),
            joints.reshape(4, 20),
            finger_pattern([5, 3, 5, 2]),
            np.array([UNIFORM, GUIDED, GUIDED, GUIDED]),
        ),
        friction=np.array([0.3, 0.4, np.nan, 0.8]),
        gap=np.array([[0, 0, 0, 0, 0.02], [0, 0, 0, 0.02, 0.02], [np.nan] * 5, [0, 0, 0.02, 0.02, 0.02]]),
        scenes=[scene] * scenes,
        drawn=np.array([20, 20]),
        trials=np.array([5, 5]),
    )
