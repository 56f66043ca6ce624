"""Runs stage 1 over a catalogue and stage 2 over scenes: parallel, resumable, by the seed alone."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import joblib
import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from dgs_description.arrays import load_arrays, save_arrays
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.grasp import GraspSet, joined
from dgs_description.hand import HAND
from dgs_learning.dataset import GraspDataset, SceneGrasps, stored_alike
from dgs_learning.objects.catalogue import SCALES, make_catalogue
from dgs_learning.objects.symmetry import symmetries_of
from dgs_learning.parallel import Engine
from dgs_learning.synthesis.closing import gap_of
from dgs_learning.synthesis.scenes import make_scene
from dgs_learning.synthesis.sdf import coarse_distance
from dgs_learning.synthesis.stage_one import Effort, ObjectGrasps, synthesise, vary
from dgs_learning.synthesis.stage_two import valid_in_scene
from dgs_sim_bridge.render.object_model import ObjectModel, catalogue_to_arrays

GRASPS_PER_OBJECT = 8000
"""Symmetric ones included, at most so many are tried in a scene: all 36 turns of 220."""

_refused = partial(DgsError, ErrorCode.REQUEST_INVALID)
_HAND = joblib.hash([getattr(HAND, fact.name) for fact in fields(HAND)])


def record_path(folder: Path, model: ObjectModel) -> Path:
    """Where the grasps of one object at one scale lie; another body of the same name, or another hand, has its own."""
    body = joblib.hash((model.vertices, model.parts, model.mass, model.friction, _HAND))
    return folder / f"{model.name}_{body[:8]}.npz"


def _same_shape(model: ObjectModel, other: ObjectModel) -> bool:
    corners = other.vertices
    return model.vertices.shape == corners.shape and np.allclose(model.vertices, corners, atol=1e-5)


def save_grasps(path: Path, found: ObjectGrasps) -> None:
    """Write the file, whole or not at all."""
    counts = {"friction": found.friction, "drawn": found.drawn, "trials": found.trials}
    save_arrays(path, vars(found.grasps) | counts)


def load_grasps(path: Path) -> ObjectGrasps:
    """Read what `save_grasps` wrote."""
    values: dict[str, Any] = load_arrays(path)
    drawn, trials = int(values.pop("drawn")), int(values.pop("trials"))
    return ObjectGrasps(
        friction=values.pop("friction"), drawn=drawn, trials=trials, grasps=GraspSet(**values)
    )


def _one(
    model: ObjectModel, key: list[int], effort: Effort, known: ObjectGrasps | None, chunks: Path
) -> tuple[ObjectModel, ObjectGrasps, int]:
    """The grasps of a model, and how many of them are `known`: None = none are made yet, else they are varied."""
    if known is None:
        return model, synthesise(model, key, effort, chunks), 0
    return model, vary(model, known, key, effort, chunks), len(known.grasps)


def generate_grasps(
    models: Sequence[tuple[ObjectModel, list[int]]], folder: Path, effort: Effort, engine: Engine
) -> int:
    """Make the grasps of every model that has none in `folder` yet.

    Killed at any time, it loses no more than the chunk that each worker is at.

    Args:
        models: objects with the seed key of each; the key, not the order of work, fixes the grasps.
        folder: one file per finished object appears here, and `chunks/` with those under way.

    Returns:
        number of grasps made in this call.
    """
    todo = [(m, key, None) for m, key in models if not record_path(folder, m).exists()]
    return _make(todo, folder, effort, engine)


def vary_grasps(
    models: Sequence[tuple[ObjectModel, list[int]]], folder: Path, effort: Effort, engine: Engine
) -> int:
    """Add variations to the grasps of every model in `folder` that has fewer than `effort.varied`.

    Arguments and what is returned as of `generate_grasps`. A model without grasps stays without.
    """
    there = [(m, key) for m, key in models if record_path(folder, m).exists()]
    known = [(m, key, load_grasps(record_path(folder, m))) for m, key in there]
    few = [each for each in known if 0 < len(each[2].grasps) < effort.varied]
    return _make(few, folder, effort, engine)


def _make(
    todo: Sequence[tuple[ObjectModel, list[int], ObjectGrasps | None]],
    folder: Path,
    effort: Effort,
    engine: Engine,
) -> int:
    folder.mkdir(parents=True, exist_ok=True)
    made, started = 0, time.monotonic()

    def chunks(model: ObjectModel) -> Path:
        return folder / "chunks" / record_path(folder, model).stem

    results = engine.run(_one, ((m, key, effort, known, chunks(m)) for m, key, known in todo))
    with tqdm(results, total=len(todo), unit="object", desc="stage 1") as progress:
        for model, found, before in progress:
            save_grasps(record_path(folder, model), found)
            shutil.rmtree(chunks(model), ignore_errors=True)
            made += len(found.grasps) - before
            progress.set_postfix(grasps=made, per_second=f"{made / (time.monotonic() - started):.2f}")
    return made


def restore(dataset: GraspDataset, models: Sequence[ObjectModel], folder: Path) -> int:
    """Lay the grasps of a dataset file out again as `generate_grasps` left them; returns of how many object-scales.

    So a run can go on from a dataset alone: what the file has is not made again. An object that has another shape there
    is none of the file's.
    """
    number = {model.name: k for k, model in enumerate(dataset.objects)}
    own = [(number[m.name], m) for m in models if m.name in number]
    missing = [
        (k, m) for k, m in own if _same_shape(m, dataset.objects[k]) and not record_path(folder, m).exists()
    ]
    for k, model in missing:
        mine = slice(dataset.first[k], dataset.first[k + 1])
        counts = int(dataset.drawn[k]), int(dataset.trials[k])
        found = ObjectGrasps(dataset.own(k), dataset.friction[mine], *counts)
        save_grasps(record_path(folder, model), found)
    return len(missing)


def collect(models: Sequence[ObjectModel], folder: Path) -> GraspDataset:
    """A dataset without scenes from the files that `generate_grasps` left; models without one are left out.

    Raises:
        DgsError: REQUEST_INVALID: it left none.
    """
    there = [m for m in models if record_path(folder, m).exists()]
    if not there:
        raise _refused(f"no grasps of these objects are in {folder}: run `dgs grasps` first")
    return packed(there, [load_grasps(record_path(folder, m)) for m in there])


def packed(models: Sequence[ObjectModel], found: Sequence[ObjectGrasps]) -> GraspDataset:
    """A dataset without scenes of objects with the grasps of each."""
    grasps = [each.grasps for each in found]
    return GraspDataset(
        objects=list(models),
        first=np.cumsum([0, *map(len, grasps)]),
        grasps=joined(grasps),
        friction=np.concatenate([np.zeros(0), *(each.friction for each in found)]),
        gap=np.concatenate([np.zeros((0, HAND.finger_count)), *(map(gap_of, models, grasps))]),
        scenes=[],
        drawn=np.array([each.drawn for each in found]),
        trials=np.array([each.trials for each in found]),
    )


def expand_by_symmetry(
    dataset: GraspDataset, number: int, limit: int, seed: int
) -> tuple[GraspSet, NDArray[np.int64]]:
    """Grasps of object `number` times its symmetries, at most `limit` drawn at random.

    Returns:
        G grasps in the object's frame, and (G, 2) of each the index among the object's own grasps and of the symmetry
        that turned it.
    """
    own = dataset.own(number)
    turns = symmetries_of(dataset.objects[number])
    pairs = np.array(list(np.ndindex(len(own), len(turns))), dtype=np.int64).reshape(-1, 2)
    pairs = np.random.default_rng([seed, number]).permutation(pairs)[:limit]
    grasps, turn = own[pairs[:, 0]], turns[pairs[:, 1]]
    position = np.einsum("nij,nj->ni", turn, grasps.position)
    grasps = replace(grasps, position=position, rotation=turn @ grasps.rotation, reference_point=position)
    return grasps, pairs


def _scene(dataset: GraspDataset, grasps: str, seed: int, number: int) -> SceneGrasps | None:
    """One scene: draw objects, settle, keep the feasible grasps; None where fewer than two objects come to rest.

    `grasps` is the hash of objects and grasps of the dataset: it tells kept scenes of others apart.
    """
    key = [seed, number]
    rng = np.random.default_rng(key)
    count, there = int(rng.integers(5, 16)), len(dataset.objects)
    drawn = rng.choice(there, min(count, there), replace=False).tolist()
    scene = make_scene(dataset.objects, drawn, key)
    if len(scene.objects) < 2:
        return None
    tried = [expand_by_symmetry(dataset, k, GRASPS_PER_OBJECT, seed) for k in scene.objects]
    expanded, origin = zip(*tried, strict=True)
    kept = valid_in_scene(scene, expanded, [coarse_distance(dataset.objects[k]) for k in scene.objects])
    pairs = np.concatenate([own[index] for own, index in zip(origin, kept, strict=True)])
    return SceneGrasps(
        objects=scene.objects,
        T_table_object=scene.T_table_object,
        instance=np.repeat(np.arange(len(kept)), [len(index) for index in kept]),
        grasp=pairs[:, 0],
        symmetry=pairs[:, 1],
    )


def generate_scenes(
    dataset: GraspDataset,
    count: int,
    seed: int,
    engine: Engine,
    folder: Path | None = None,
) -> GraspDataset:
    """The dataset with `count` more scenes of 5 to 15 objects; scene k depends on the grasps, the seed and k alone.

    Their numbers begin where those of the scenes that it has must have ended: with the same seed, too, they are others.

    Args:
        count: scenes tried; one in which fewer than two objects come to rest is left out.
        folder: finished scenes are kept here, so that a killed run goes on where it was.
    """
    make = joblib.Memory(folder, verbose=0).cache(_scene, ignore=["dataset"])
    grasps = joblib.hash((catalogue_to_arrays(dataset.objects), dataset.first, dataset.grasps))
    first = 2 * len(dataset.scenes)  # of those tried, more than half are kept
    jobs = ((dataset, grasps, seed, k) for k in range(first, first + count))
    scenes: list[SceneGrasps] = []
    with tqdm(engine.run(make, jobs, ordered=True), total=count, unit="scene", desc="stage 2") as progress:
        for scene in progress:
            scenes += [] if scene is None else [scene]
            progress.set_postfix(grasps=sum(len(s.instance) for s in scenes))
    return replace(dataset, scenes=[*dataset.scenes, *scenes])


def with_scenes_of(dataset: GraspDataset, known: GraspDataset) -> GraspDataset:
    """The dataset with the scenes of another, which has some of its objects, each with the first of its grasps.

    Raises:
        DgsError: REQUEST_INVALID, an object of the other is none of its own, has another shape, or its grasps do not
            begin as there.
    """
    number = {model.name: k for k, model in enumerate(dataset.objects)}
    missing = [model.name for model in known.objects if model.name not in number]
    if missing:
        cure = "run `dgs grasps` with --known and the same --others first"
        raise _refused(f"no grasps of {missing[0]} are there: {cure}")
    own = np.array([number[model.name] for model in known.objects])
    for k, model in enumerate(known.objects):
        kept = known.own(k)
        if not _same_shape(model, dataset.objects[own[k]]):
            cure = "make the scenes anew, without --known"
            raise _refused(f"{model.name} had another shape in the known dataset: {cure}")
        if not stored_alike(dataset.own(own[k])[: len(kept)], kept):
            cure = "take its file out of data/stage1 and run `dgs grasps` with --known first"
            raise _refused(f"the grasps of {model.name} do not begin as known: {cure}")
    scenes = [replace(scene, objects=own[scene.objects]) for scene in known.scenes]
    return replace(dataset, scenes=[*dataset.scenes, *scenes])


def work_list(
    seed: int, scales: int, others: Sequence[ObjectModel] = ()
) -> list[tuple[ObjectModel, list[int]]]:
    """Training objects with `scales` of their five scales each and their seed keys, in a random order of classes.

    The first scale of object k is k mod 5, so that a run with fewer scales is a part of one with more.

    Args:
        seed: first part of every key.
        scales: of each object.
        others: objects that the catalogue lacks; what is made of the catalogue's does not depend on them.

    Raises:
        DgsError: REQUEST_INVALID: two objects have the same name.
    """
    catalogue = [*make_catalogue("train"), *others]
    names = [model.name for model in catalogue]
    if doubled := next((name for name in names if names.count(name) > 1), ""):
        raise _refused(f"two objects are named {doubled}: rename one")
    order = np.random.default_rng(0).permutation(len(catalogue))
    return [
        (catalogue[k].scaled(SCALES[(k + turn) % 5]), [seed, int(k), int((k + turn) % 5)])
        for turn in range(scales)
        for k in order
    ]
