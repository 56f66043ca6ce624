"""Stored grasps simulated again: alone by the six-axis test (stage 1), or executed in their scene (stage 2)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Memory
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, inverse, transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.paths import revision, today
from dgs_grasp_planner.network.weights import file_sha256
from dgs_learning.dataset import GraspDataset, load_dataset
from dgs_learning.evaluation.metrics import spread, wilson
from dgs_learning.evaluation.penetration import PenetrationMeter
from dgs_learning.evaluation.scene_world import SUCCESS_HEIGHT, SceneWorld
from dgs_learning.parallel import Engine
from dgs_learning.paths import kept_folder
from dgs_learning.synthesis.scenes import Scene
from dgs_learning.synthesis.trial import RULES, FloatingHand
from dgs_sim_bridge.render.object_model import ObjectModel

STAGES = (1, 2)
THUMB_PITCH = 1
"""The second joint of the first finger, whatever a hand calls it."""


@dataclass(frozen=True)
class Check:
    """What became of one stored grasp.

    Attributes:
        number: row of the grasp among all grasps of its stage in the file.
        shape_class: of the object it grasps.
        fingers: 2 to 5.
        passed: held by the six-axis test, or lifted by 0.1 m and held through a shake.
        how: the stage it ended at.
        penetration_mm: depth of the stored final hand in the object (stage 1) or in all objects of the scene [mm].
        shift_mm, turn_deg: how the object moved while the hand closed (stage 1).
        saturated: the thumb's pitch motor was at its limit after closing (stage 1).
    """

    number: int
    shape_class: str
    fingers: int
    passed: bool
    how: str
    penetration_mm: float
    shift_mm: float = 0.0
    turn_deg: float = 0.0
    saturated: bool = False


_meter = cache(PenetrationMeter)


def check_alone(
    number: int,
    model: ObjectModel,
    grasp: GraspSet,
    key: list[int],
    engine: str,
    friction: float | None,
    rules: str,
) -> Check:
    """Six-axis test in a world of its own, object and hand in a random common pose.

    Args:
        grasp: one stored grasp in the object's frame, quantisation included.
        key: seed of the pose; it is never one that the synthesis used, where every object stands at the origin.
        engine: one of `engines.ENGINES`.
        friction: of the hand; None = the rules', else the engine's.
        rules: one of `trial.RULES`.
    """
    must = RULES[rules]
    if must.mass is not None:
        model = replace(model, mass=must.mass)
    depth = _meter()(grasp.grasp_joints, grasp.pose, [model], [np.eye(4)]).depth_mm
    rng = np.random.default_rng(key)
    T_world_object = transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-0.5, 0.5, 3))
    with FloatingHand(model, engine, must.friction if friction is None else friction) as hand:
        closed = hand.close(grasp, T_world_object)
        torques = hand.world.joints()[1]
        deep = depth > 1e3 * must.max_depth
        stable = not deep and closed.touching and hand.shake(must)
    # Where the object is now, in the frame that it started in.
    T_before_after = grasp.pose @ inverse(closed.T_object_tcp)
    return Check(
        number,
        model.shape_class,
        int(grasp.active_fingers.sum()),
        passed=stable,
        how="stable" if stable else "penetration" if deep else "gravity" if closed.touching else "closing",
        penetration_mm=depth,
        shift_mm=1e3 * float(np.linalg.norm(T_before_after[:3, 3])),
        turn_deg=float(np.rad2deg(Rotation.from_matrix(T_before_after[:3, :3]).magnitude())),
        saturated=bool(abs(torques[THUMB_PITCH]) > 0.98 * HAND.effort[THUMB_PITCH]),
    )


def check_in_scene(
    number: int,
    models: list[ObjectModel],
    poses: Array,
    instance: int,
    grasp: GraspSet,
    engine: str,
    friction: float | None,
) -> Check:
    """Execute the grasp on the table among all objects of its scene: approach, close, lift, shake.

    Args:
        poses: (N, 4, 4) T_table_object.
        instance: which of them is grasped.
        grasp: one stored grasp in the frame *table*.
        engine, friction: as in `check_alone`.
    """
    with SceneWorld(models, Scene(np.arange(len(models)), poses), engine, friction) as world:
        world.settle()
        before = world.object_poses()[instance]
        attempt = world.execute(grasp)
        lifted = bool(world.object_poses()[instance][2, 3] - before[2, 3] > SUCCESS_HEIGHT)
    how = "lifted" if lifted else attempt.outcome.value
    if not lifted and attempt.outcome.value == "success":
        how = "another object lifted"
    depth = _meter()(grasp.grasp_joints, grasp.pose, models, list(poses)).depth_mm
    fingers = int(grasp.active_fingers.sum())
    return Check(number, models[instance].shape_class, fingers, lifted, how, penetration_mm=depth)


def draw(among: NDArray[np.bool_], count: int, seed: int, stage: int) -> list[int]:
    """`count` of the grasps that are marked in `among` (G,), or all if there are fewer.

    A larger count only adds to a smaller one.
    """
    order = np.random.default_rng([seed, stage]).permutation(len(among))
    return order[among[order]][:count].tolist()


def _alone(data: GraspDataset, numbers: Sequence[int], seed: int) -> Iterator[tuple[Any, ...]]:
    owner = data.owner
    for number in numbers:
        yield number, data.objects[owner[number]], data.grasps[number], [seed, 1, number]


def _in_scenes(data: GraspDataset, numbers: Sequence[int]) -> Iterator[tuple[Any, ...]]:
    first = np.cumsum([0, *(len(scene.instance) for scene in data.scenes)])
    for number in numbers:
        s = int(np.searchsorted(first, number, side="right")) - 1
        scene, row = data.scenes[s], number - int(first[s])
        models = [data.objects[k] for k in scene.objects]
        grasp = data.scene_grasps(scene)[row]
        yield number, models, scene.T_table_object, int(scene.instance[row]), grasp


def of_kind(
    data: GraspDataset, stage: int, classes: Sequence[str], fingers: Sequence[int]
) -> NDArray[np.bool_]:
    """Which grasps of a stage are on an object of one of these shape classes or use so many fingers.

    Nothing given for either means every grasp.
    """
    classed = np.array([model.shape_class in classes for model in data.objects], dtype=bool)[data.owner]
    mark = classed | np.isin(data.fingers, fingers) | (not classes and not fingers)
    if stage == 1:
        return mark
    return np.concatenate([np.zeros(0, bool), *(mark[data.rows(scene)] for scene in data.scenes)])


def validate(
    file: Path,
    stage: int,
    count: int,
    seed: int,
    engine: Engine,
    folder: Path,
    classes: Sequence[str] = (),
    fingers: Sequence[int] = (),
    physics: str = "pybullet",
    friction: float | None = None,
    rules: str = "paper",
) -> dict[str, Any]:
    """Simulate `count` grasps of a dataset file again.

    Args:
        stage: 1 (single objects) or 2 (scenes).
        seed: decides which, and the poses they are tried in.
        classes, fingers: draw among grasps of these shape classes or numbers of fingers only; nothing = among all.
        folder: finished checks are kept here, and not made again by the same revision.
        physics, friction, rules: as in `check_alone`; rules are for stage 1.

    Raises:
        ValueError: no such stage.
        DgsError: REQUEST_INVALID: the file has no such grasps.
    """
    if stage not in STAGES:
        raise ValueError(f"there is no stage {stage}, only {' and '.join(map(str, STAGES))}")
    data = load_dataset(file)
    numbers = draw(of_kind(data, stage, classes, fingers), count, seed, stage)
    if not len(numbers):
        kind = " of the classes and fingers that are asked for" if classes or fingers else ""
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{file} has no grasps of stage {stage}{kind}")
    made_by = revision()
    memory = Memory(kept_folder(folder, made_by), verbose=0)
    check = memory.cache(check_alone if stage == 1 else check_in_scene)
    drawn = _alone(data, numbers, seed) if stage == 1 else _in_scenes(data, numbers)
    jobs = ((*job, physics, friction, *([rules] if stage == 1 else [])) for job in drawn)
    checks: list[Check] = []
    with tqdm(engine.run(check, jobs), total=len(numbers), unit="grasp", desc=f"stage {stage}") as progress:
        for checked in progress:
            checks.append(checked)
            progress.set_postfix(passed=sum(c.passed for c in checks))
    about: dict[str, Any] = {
        "stage": stage,
        "seed": seed,
        "engine": physics,
        "friction": friction,
        "rules": rules,
        "dataset": file.name,
        "dataset_sha256": file_sha256(file)[:16],
    }
    if classes or fingers:
        about |= {"classes": list(classes), "fingers": list(fingers)}
    checks.sort(key=lambda c: c.number)
    failed = [c.number for c in checks if not c.passed]
    return {**about, "revision": made_by, "date": today(), **summarise(checks), "failed": failed}


def _share(checks: Sequence[Check]) -> dict[str, Any]:
    passed = sum(c.passed for c in checks)
    return {"tried": len(checks), "passed": passed, "share": passed / max(1, len(checks))}


def summarise(checks: Sequence[Check]) -> dict[str, Any]:
    """Counts in all, per class and per number of fingers; how the rest ended; penetration [mm]."""
    ends = [c.how for c in checks]
    return {
        **_share(checks),
        "interval": wilson(sum(c.passed for c in checks), len(checks)),
        "penetration_mm": {
            **spread([c.penetration_mm for c in checks]),
            "max": max((c.penetration_mm for c in checks), default=0.0),
        },
        "shift_mm": spread([c.shift_mm for c in checks]),
        "turn_deg": spread([c.turn_deg for c in checks]),
        "thumb_saturated": sum(c.saturated for c in checks) / max(1, len(checks)),
        "ends": {how: ends.count(how) for how in sorted(set(ends))},
        "by_class": _by(checks, "shape_class"),
        "by_fingers": _by(checks, "fingers"),
    }


def _by(checks: Sequence[Check], name: str) -> dict[str, Any]:
    values = sorted({getattr(check, name) for check in checks})
    return {str(value): _share([c for c in checks if getattr(c, name) == value]) for value in values}
