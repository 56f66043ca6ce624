"""One stored grasp, simulated again: alone by the six-axis test (stage 1), or executed in its full scene (stage 2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgs_description.frames import transform
from dgs_description.grasp import GraspSet
from dgs_learning.evaluation.penetration import PenetrationMeter
from dgs_learning.evaluation.scene_world import SUCCESS_HEIGHT, SceneWorld
from dgs_learning.synthesis.scenes import Scene
from dgs_learning.synthesis.trial import FloatingHand
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.physics import PHYSICS

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Check:
    """What became of one stored grasp.

    Attributes:
        number: row of the grasp among all grasps of its stage in the file.
        scene: of stage 2, -1 in stage 1.
        object_name, shape_class: of the object it grasps.
        fingers: 5, 3 or 2.
        passed: held by the six-axis test, or lifted by 0.1 m and held through a shake.
        how: the stage it ended at.
        penetration_mm: depth of the stored final hand in the object (stage 1) or in all objects of the scene [mm].
    """

    number: int
    scene: int
    object_name: str
    shape_class: str
    fingers: int
    passed: bool
    how: str
    penetration_mm: float


@cache
def _meter() -> PenetrationMeter:
    return PenetrationMeter()


def _check(
    number: int, scene: int, model: ObjectModel, grasp: GraspSet, passed: bool, how: str, depth: float
) -> Check:
    fingers = int(grasp.active_fingers.sum())
    return Check(number, scene, model.name, model.shape_class, fingers, passed, how, depth)


def check_alone(number: int, model: ObjectModel, grasp: GraspSet, key: list[int]) -> Check:
    """Six-axis test in a world of its own, object and hand in a random common pose.

    Args:
        number: of the grasp.
        model: the object.
        grasp: one stored grasp in the object's frame, quantisation included.
        key: seed of the pose; it is never one that the synthesis used, where every object stands at the origin.
    """
    rng = np.random.default_rng(key)
    T_world_object = transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.5, 0.5, 3))
    with FloatingHand(model, PHYSICS) as world:
        touching = world.close(grasp, T_world_object).touching
        stable = touching and world.shake()
    how = "stable" if stable else "gravity" if touching else "closing"
    depth = _meter()(grasp.grasp_joints, grasp.pose, [model], [np.eye(4)]).depth_mm
    return _check(number, -1, model, grasp, stable, how, depth)


def check_in_scene(
    number: int, scene: int, models: list[ObjectModel], poses: Array, instance: int, grasp: GraspSet
) -> Check:
    """Execute the grasp on the table among all objects of its scene: approach, close, lift, shake.

    Args:
        number: of the grasp.
        scene: its scene.
        models: of the scene's objects.
        poses: (N, 4, 4) T_table_object.
        instance: which of them is grasped.
        grasp: one stored grasp in the frame *table*.
    """
    with SceneWorld(models, Scene(np.arange(len(models)), poses)) as world:
        world.settle()
        before = world.object_poses()[instance]
        attempt = world.execute(grasp)
        lifted = bool(world.object_poses()[instance][2, 3] - before[2, 3] > SUCCESS_HEIGHT)
    how = "lifted" if lifted else attempt.outcome.value
    if not lifted and attempt.outcome.value == "success":
        how = "another object lifted"
    depth = _meter()(grasp.grasp_joints, grasp.pose, models, list(poses)).depth_mm
    return _check(number, scene, models[instance], grasp, lifted, how, depth)
