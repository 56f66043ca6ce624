"""Trials: candidates of the planner, the likely and the others, executed one by one from the same scene.

What was seen of each (`success.evidence`) and whether it held is what the planner's ranking is fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from dgs_description.arrays import load_arrays, save_arrays
from dgs_description.frames import Array
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.load import load_planner
from dgs_grasp_planner.planner import GraspPlanner
from dgs_grasp_planner.scene import PlanRequest, Prediction, prepare
from dgs_grasp_planner.success import EVIDENCE, evidence, success_model
from dgs_learning import paths
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.experiment import Row
from dgs_learning.evaluation.protocol import Setting, draw_scene, plan
from dgs_learning.evaluation.provenance import describe_catalogue, describe_planner
from dgs_learning.evaluation.scene_world import Outcome
from dgs_learning.made_from import mark_folder
from dgs_learning.objects.catalogue import load_part
from dgs_learning.objects.stretched import stretched
from dgs_learning.parallel import Engine
from dgs_learning.training.views import capture
from dgs_sim_bridge.render.object_model import ObjectModel

LEAST_PROPOSED = 0.3
"""Proposer's score of a candidate that is tried."""
APART, LIKELY, OTHERS = 0.05, 6, 8
"""Of the best so many that stand so far apart [m] are tried, and so many of the others."""
WORN_SHARE, PYBULLET_SHARE = 0.4, 0.4
OBJECTS = (3, 10)
"""Per scene."""
STRETCHED_SHARE = 0.7
"""Of the scenes whose objects are stretched along their axes, to be flat, wide, thin or long as no catalogue is."""


@dataclass(frozen=True)
class Trials:
    """N executed candidates.

    Attributes:
        evidence: (N, `EVIDENCE`).
        held: (N,) lifted and held.
        worn, mujoco: (N,) hardware and engine of the trial.
        scene: (N,) number of its scene, unique in the set.
    """

    evidence: Array
    held: NDArray[np.bool_]
    worn: NDArray[np.bool_]
    mujoco: NDArray[np.bool_]
    scene: NDArray[np.int64]


def load_trials(folders: Sequence[Path]) -> Trials:
    """The trials in all files of some folders; scenes of different folders are told apart.

    Raises:
        ValueError: there are none, or they are of other evidence.
    """
    found = []
    for number, folder in enumerate(folders):
        for file in sorted(folder.glob("*.npz")):
            values = load_arrays(file)
            if set(values) != set(Trials.__annotations__):
                raise ValueError(f"{file} holds no trials")
            values["scene"] = values["scene"] + 1_000_000 * number
            found.append(Trials(**values))
    if not any(len(each.held) for each in found):
        raise ValueError(f"no trials in {', '.join(map(str, folders))}: make some with `dgs trials`")
    if any(each.evidence.shape[1] != len(EVIDENCE) for each in found):
        raise ValueError(f"trials of other evidence than the {len(EVIDENCE)} columns of this program")
    return Trials(*(np.concatenate([getattr(t, name) for t in found]) for name in Trials.__annotations__))


class _Candidates:
    """A planner that answers all candidates, in their order, and keeps what was seen of them."""

    def __init__(self, planner: GraspPlanner):
        self._planner = planner
        self.evidence = np.zeros((0, len(EVIDENCE)))

    def __call__(
        self, cloud: NDArray[np.float32], camera: ArrayLike, rng: np.random.Generator, request: PlanRequest
    ) -> Prediction:
        wanted = replace(request, min_score=LEAST_PROPOSED)
        scene = prepare(cloud, np.asarray(camera), rng, wanted, self._planner.settings.keep_table)
        grasps, rejected = self._planner.candidates(scene)
        if len(grasps):
            self.evidence = evidence(grasps, scene.field.separated)
        return Prediction(grasps, len(scene.points), scene.clock.finish(), rejected)


def try_scene(catalogue: Sequence[ObjectModel], planner: GraspPlanner, seed: int, number: int) -> Trials:
    """Candidates of one scene of a catalogue, each executed from the settled scene.

    Args:
        catalogue: 3 to 10 of its objects are drawn.
        seed, number: decide about objects, view, engine, wear and which candidates.
    """
    draws = np.random.default_rng([seed, 106, number])
    worn, mujoco = draws.random() < WORN_SHARE, draws.random() >= PYBULLET_SHARE
    if draws.random() < STRETCHED_SHARE:
        catalogue = [stretched(model, draws) for model in catalogue]
    setting, condition, key = Setting(1, OBJECTS, seed=seed), Condition(worn=worn), [seed, 104, number]
    scene, seen = draw_scene(catalogue, setting, number), _Candidates(planner)
    with condition.world(catalogue, scene, "mujoco" if mujoco else "pybullet", key) as world:
        world.settle()
        rest = world.object_poses()
        view = capture(*world.scene(), draws, condition.views(setting.seen))
        grasps = plan(condition.disturb(seen, key), view, draws).grasps
        chosen = _chosen(grasps, seen.evidence, draws)
        held = []
        for k in chosen:
            for index, T in rest.items():
                world.world.place(index, T)
            held.append(world.execute(grasps[k]).outcome is Outcome.SUCCESS)
    marks = (np.full(len(chosen), mark) for mark in (worn, mujoco, number))
    return Trials(seen.evidence[chosen], np.array(held, dtype=bool), *marks)


def _chosen(grasps: GraspSet, values: Array, draws: np.random.Generator) -> list[int]:
    """Of the grasps that are ranked by their evidence: those without a motion."""
    still = np.flatnonzero(~grasps.motion.any(axis=1))
    order = still[np.argsort(-success_model()(values[still]))].tolist()
    best: list[int] = []
    for k in order:
        if len(best) < LIKELY and all(
            np.linalg.norm(grasps.position[k] - grasps.position[b]) > APART for b in best
        ):
            best.append(k)
    rest = [k for k in order if k not in best]
    return best + draws.permutation(rest)[:OTHERS].astype(int).tolist()


def run_trials(objects: str, scenes: tuple[int, int], seed: int, folder: Path, engine: Engine) -> int:
    """Try the scenes first..last - 1 that `folder` has no file of yet; returns how many candidates were executed.

    Args:
        objects: a catalogue as `load_part` takes it.
        scenes: first and one past the last.
        folder: one file per scene.

    Raises:
        DgsError: REQUEST_INVALID: the folder holds trials of other objects, another seed or other weights.
    """
    folder.mkdir(parents=True, exist_ok=True)
    catalogue = load_part(objects)
    planner = describe_planner(Row("trials"))
    weights = {key: planner[key] for key in ("model_sha256", "shape_completion_sha256")}
    mark_folder(
        folder, {"objects": describe_catalogue(objects, catalogue)["sha256"], "seed": seed, **weights}
    )
    todo = [n for n in range(*scenes) if not (folder / f"{n:05d}.npz").exists()]
    running = engine.run(_one, ((catalogue, seed, n, folder) for n in todo))
    return sum(tqdm(running, total=len(todo), unit="scene"))


@cache
def _planner() -> GraspPlanner:
    torch.set_num_threads(1)
    return load_planner(paths.weights_dir())


def _one(catalogue: Sequence[ObjectModel], seed: int, number: int, folder: Path) -> int:
    trials = try_scene(catalogue, _planner(), seed, number)
    save_arrays(folder / f"{number:05d}.npz", vars(trials))
    return len(trials.held)
