"""The paper's clearing protocol (section VI) for a free hand: capture, plan, execute the best grasp, re-capture, until nothing is left."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import transform
from dgs_grasp_planner.grasp import GraspSet, Prediction
from dgs_learning.evaluation.scene_world import Outcome, SceneWorld
from dgs_learning.synthesis.scenes import Scene, make_scene
from dgs_learning.training.views import ViewSettings, capture
from dgs_sim_bridge.object_model import ObjectModel

Array = NDArray[np.float64]
Planner = Callable[[NDArray[np.float32], Array, np.random.Generator], Prediction]

MAX_FAILURES = 3
"""After so many failed attempts an object is taken away (paper)."""


@dataclass(frozen=True)
class Setting:
    """One experiment.

    Attributes:
        objects_per_scene: smallest and largest number of objects.
        area: x and y extent of the workspace [m].
        ablate: "none", "pre_grasp" (fixed open hand) or "offset" (zero offset), as in Table II.
    """

    scenes: int = 10
    objects_per_scene: tuple[int, int] = (10, 10)
    area: tuple[float, float] = (0.6, 0.6)
    seed: int = 0
    ablate: str = "none"


@dataclass(frozen=True)
class AttemptRecord:
    """One attempt of one scene.

    Attributes:
        scene: number of the scene, attempt: number within it.
        object_name, shape_class: of the object that was gripped at.
        outcome: how it ended; "no grasp found" where the planner answered none.
        score: of the grasp.
        seconds: the planner's time.
    """

    scene: int
    attempt: int
    object_name: str
    shape_class: str
    outcome: str
    score: float
    seconds: float
    position: tuple[float, ...] = ()
    rotation: tuple[float, ...] = ()
    pre_grasp: tuple[float, ...] = ()
    grasp: tuple[float, ...] = ()


@dataclass(frozen=True)
class SceneResult:
    """One scene: how many objects it had, how many were lifted, and every attempt."""

    scene: int
    objects: int
    cleared: int
    attempts: tuple[AttemptRecord, ...]


NO_GRASP = "no grasp found"


def draw_scene(catalogue: Sequence[ObjectModel], setting: Setting, number: int) -> Scene:
    """Scene `number` of a setting: objects drawn without repetition, dropped, settled."""
    rng = np.random.default_rng([setting.seed, 101, number])
    low, high = setting.objects_per_scene
    count = int(rng.integers(low, high + 1))
    chosen = rng.choice(len(catalogue), min(count, len(catalogue)), replace=False)
    return make_scene(catalogue, chosen.tolist(), [setting.seed, 102, number], setting.area)


def ablated(grasps: GraspSet, ablate: str) -> GraspSet:
    """The grasps with one prediction taken away (Table II)."""
    if ablate == "pre_grasp":
        return replace(grasps, pre_grasp_joints=np.zeros_like(grasps.pre_grasp_joints))
    if ablate == "offset":
        return replace(grasps, position=grasps.reference_point.copy(), offset=np.zeros_like(grasps.offset))
    return grasps


def run_scene(
    catalogue: Sequence[ObjectModel], planner: Planner, setting: Setting, number: int, views: ViewSettings | None = None
) -> SceneResult:
    """Clear one scene.

    Args:
        catalogue: objects to draw from.
        planner: cloud (N, 3), camera position (3,), generator -> Prediction, all in the frame *table*.
        setting: the experiment.
        number: of the scene; scene and views depend on it and the seed alone.
    """
    scene = draw_scene(catalogue, setting, number)
    rng = np.random.default_rng([setting.seed, 103, number])
    half_x, half_y = setting.area[0] / 2 + 0.1, setting.area[1] / 2 + 0.1
    views = views or replace(ViewSettings(), crop=(half_x, half_y, 0.30))
    attempts: list[AttemptRecord] = []
    failures: dict[int, int] = {}
    cleared = 0
    with SceneWorld(catalogue, scene) as world:
        world.settle()
        while world.bodies and len(attempts) < MAX_FAILURES * len(scene.objects):
            models, poses = world.scene()
            view = capture(models, poses, rng, views)
            started = time.perf_counter()
            try:
                grasps = ablated(planner(view.points, view.camera, rng).grasps, setting.ablate)
            except DgsError as error:
                if error.code not in (ErrorCode.NO_OBJECTS, ErrorCode.NO_GRASP, ErrorCode.CLOUD_EMPTY):
                    raise
                grasps = GraspSet.empty()
            seconds = time.perf_counter() - started
            if not len(grasps):
                attempts.append(AttemptRecord(number, len(attempts), "", "", NO_GRASP, 0.0, seconds))
                if len(attempts) >= 2 and attempts[-2].outcome == NO_GRASP:
                    break  # two views without a grasp: nothing graspable is left
                continue
            T_table_tcp = transform(grasps.rotation[0], grasps.position[0])
            result = world.execute(T_table_tcp, grasps.pre_grasp_joints[0], grasps.grasp_joints[0])
            target = world.models[result.object_index]
            attempts.append(
                AttemptRecord(
                    number,
                    len(attempts),
                    target.name,
                    target.shape_class,
                    result.outcome.value,
                    float(grasps.score[0]),
                    seconds,
                    tuple(grasps.position[0].tolist()),
                    tuple(grasps.rotation[0].ravel().tolist()),
                    tuple(grasps.pre_grasp_joints[0].tolist()),
                    tuple(grasps.grasp_joints[0].tolist()),
                )
            )
            if result.outcome is Outcome.SUCCESS:
                cleared += 1
                world.remove(result.object_index)
            else:
                failures[result.object_index] = failures.get(result.object_index, 0) + 1
                if failures[result.object_index] >= MAX_FAILURES:
                    world.remove(result.object_index)
            world.settle()
            world.drop_lost((half_x, half_y))
    return SceneResult(number, len(scene.objects), cleared, tuple(attempts))
