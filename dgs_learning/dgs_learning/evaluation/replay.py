"""The harness measured against itself: validated grasps of the dataset, carried to where the objects really lie."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from dgs_description.frames import apply
from dgs_description.grasp import GraspSet, Prediction
from dgs_description.hand_model import pre_grasp
from dgs_learning.dataset import GraspDataset
from dgs_learning.evaluation.protocol import Truth
from dgs_learning.synthesis.generate import expand_by_symmetry
from dgs_learning.synthesis.scenes import Scene
from dgs_learning.synthesis.sdf import coarse_distance
from dgs_learning.synthesis.stage_two import ObjectGrasps, valid_in_scene
from dgs_sim_bridge.render.object_model import ObjectModel

Array = NDArray[np.float64]

GRASPS_PER_OBJECT = 250
"""After turning by the object's symmetries."""


class StoredGrasps:
    """The dataset's grasps by object name, shared by all scenes."""

    def __init__(self, dataset: GraspDataset):
        self.grasps = {
            model.name: expand_by_symmetry(dataset, k, GRASPS_PER_OBJECT, 0)[0]
            for k, model in enumerate(dataset.objects)
        }

    def grasps_of(self, model: ObjectModel) -> ObjectGrasps:
        """Grasps in the object's frame.

        Raises:
            ValueError: the object is none of the dataset's.
        """
        if model.name not in self.grasps:
            raise ValueError(f"the dataset has no grasps of {model.name}: replay needs `--objects dataset`")
        return self.grasps[model.name]

    def feasible(self, truth: Truth) -> GraspSet:
        """The grasps that stage 2 finds feasible in a scene as it really is, frame *table*, object by object."""
        models, poses = truth.scene()
        own = [self.grasps_of(model) for model in models]
        scene = Scene(np.arange(len(models)), np.array(poses).reshape(-1, 4, 4))
        kept = valid_in_scene(scene, own, [coarse_distance(model) for model in models])
        sets = [_placed(T, g, index) for T, g, index in zip(poses, own, kept, strict=True) if len(index)]
        if not sets:
            return GraspSet.empty()
        return GraspSet(*(np.concatenate(column) for column in zip(*sets, strict=True)))


class ReplayPlanner:
    """Answers stored grasps that stage 2 finds feasible in the scene as it really is, in random order."""

    def __init__(self, stored: StoredGrasps, truth: Truth, max_grasps: int = 32):
        self.stored = stored
        self.truth = truth
        self.max_grasps = max_grasps

    def __call__(
        self, cloud: NDArray[np.float32], camera_position: Array, rng: np.random.Generator
    ) -> Prediction:
        """Grasps in the frame *table*; cloud and camera are not used."""
        start = time.perf_counter()
        grasps = self.stored.feasible(self.truth)
        grasps = grasps.select(rng.permutation(len(grasps))[: self.max_grasps])
        return Prediction(grasps, len(cloud), {"total": time.perf_counter() - start})


def _placed(T_table_object: Array, grasps: ObjectGrasps, index: NDArray[np.int64]) -> tuple[Array, ...]:
    position = apply(T_table_object, grasps.position[index])
    joints = grasps.joints[index]
    shapes = pre_grasp(joints, grasps.active[index])
    rotation = T_table_object[:3, :3] @ grasps.rotation[index]
    return position, rotation, shapes, joints, np.ones(len(index)), position.copy(), np.zeros_like(position)
