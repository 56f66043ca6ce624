"""The harness measured against itself: validated grasps of the dataset, carried to where the objects really lie."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dgs_description.grasp import GraspSet, joined
from dgs_grasp_planner.scene import Scene
from dgs_learning.dataset import GraspDataset
from dgs_learning.evaluation.protocol import Truth
from dgs_learning.synthesis.generate import expand_by_symmetry
from dgs_learning.synthesis.scenes import Scene as PlacedObjects
from dgs_learning.synthesis.sdf import coarse_distance
from dgs_learning.synthesis.stage_two import valid_in_scene

GRASPS_PER_OBJECT = 250
"""After turning by the object's symmetries."""
PROPOSED = 32
"""At most, in one call."""


class StoredGrasps:
    """The dataset's grasps by object name, shared by all scenes."""

    def __init__(self, dataset: GraspDataset):
        self.grasps = {
            model.name: expand_by_symmetry(dataset, k, GRASPS_PER_OBJECT, 0)[0]
            for k, model in enumerate(dataset.objects)
        }

    def feasible(self, truth: Truth) -> GraspSet:
        """The grasps that stage 2 finds feasible in a scene as it really is, frame *table*, object by object.

        Raises:
            ValueError: an object is none of the dataset's.
        """
        models, poses = truth()
        for model in models:
            if model.name not in self.grasps:
                raise ValueError(
                    f"the dataset has no grasps of {model.name}: replay needs `--objects dataset`"
                )
        own = [self.grasps[model.name] for model in models]
        scene = PlacedObjects(np.arange(len(models)), np.array(poses).reshape(-1, 4, 4))
        kept = valid_in_scene(scene, own, [coarse_distance(model) for model in models])
        grasps = joined([g[index].moved(T) for T, g, index in zip(poses, own, kept, strict=True)])
        return replace(grasps, source=np.full(len(grasps), "replay"))


@dataclass(frozen=True)
class Replay:
    """Proposes some of the stored grasps that are feasible in the scene as it really is, in random order."""

    stored: StoredGrasps
    truth: Truth

    def __call__(self, scene: Scene) -> GraspSet:
        """Grasps in the frame *table*; the cloud is not used."""
        grasps = self.stored.feasible(self.truth)
        return grasps[scene.rng.permutation(len(grasps))[:PROPOSED]]
