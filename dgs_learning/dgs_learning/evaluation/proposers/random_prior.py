"""Baseline without perception: grasps drawn from the training distribution and dropped at random object points."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from dgs_description.frames import OBJECT_HEIGHT, Array, apply, inverse
from dgs_description.grasp import GraspSet, joined
from dgs_grasp_planner.scene import Scene
from dgs_learning.dataset import GraspDataset, SceneGrasps
from dgs_sim_bridge.render.object_model import ObjectModel

DRAWS = 256
"""Grasps drawn per cloud."""
SURFACE_POINTS = 600


def surface_points(model: ObjectModel) -> Array:
    """(`SURFACE_POINTS`, 3) points spread over the mesh, the same at every call [m]."""
    a, b, c = (model.vertices[model.faces[:, k]].astype(np.float64) for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rng = np.random.default_rng(0)
    face = rng.choice(len(area), SURFACE_POINTS, p=area / area.sum())
    u, v = rng.random((2, SURFACE_POINTS, 1))
    flip = u + v > 1
    u, v = np.where(flip, 1 - u, u), np.where(flip, 1 - v, v)
    return a[face] + u * (b[face] - a[face]) + v * (c[face] - a[face])


def prior_of(dataset: GraspDataset) -> GraspSet:
    """The stage-2 grasps of all scenes with their reference points, the nearest of the surface, moved to the origin.

    Axes as in the frame *table*: a grasp's position is its offset.

    Raises:
        ValueError: the dataset has no scene grasps.
    """
    trees: dict[int, cKDTree] = {}
    found = [_about_origin(dataset, scene, trees) for scene in dataset.scenes if len(scene.instance)]
    if not found:
        raise ValueError("the dataset has no scenes with grasps: run `dgs scenes`")
    return joined(found)


def _about_origin(dataset: GraspDataset, scene: SceneGrasps, trees: dict[int, cKDTree]) -> GraspSet:
    grasps = dataset.scene_grasps(scene)
    offset = np.empty_like(grasps.position)
    for instance in np.unique(scene.instance):
        k, mine = int(scene.objects[instance]), scene.instance == instance
        if k not in trees:
            trees[k] = cKDTree(surface_points(dataset.objects[k]))
        T_table_object = scene.T_table_object[instance]
        local = apply(inverse(T_table_object), grasps.position[mine])
        nearest = trees[k].data[trees[k].query(local)[1]]
        offset[mine] = (local - nearest) @ T_table_object[:3, :3].T
    return replace(grasps, position=offset, reference_point=np.zeros_like(offset))


@dataclass(frozen=True)
class RandomPrior:
    """Draws grasps of a prior with random headings and drops them at random object points, in random order."""

    prior: GraspSet

    def __call__(self, scene: Scene) -> GraspSet:
        """Grasps with the order of drawing as score."""
        rng, high = scene.rng, scene.points[scene.points[:, 2] > OBJECT_HEIGHT].astype(np.float64)
        if not len(high):
            return GraspSet.empty()
        reference = high[rng.integers(0, len(high), DRAWS)]
        drawn = self.prior[rng.integers(0, len(self.prior), DRAWS)]
        turn = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi, (DRAWS, 1))).as_matrix()
        return replace(
            drawn,
            position=reference + np.einsum("nij,nj->ni", turn, drawn.position),
            rotation=turn @ drawn.rotation,
            score=np.linspace(1.0, 0.0, DRAWS),
            reference_point=reference,
            source=np.full(DRAWS, "random_prior"),
        )
