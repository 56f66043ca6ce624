"""Runs stage 1 over a catalogue and stage 2 over scenes.

Parallel, resumable, the same result for the same seed on any number of workers.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from dgs_learning.dataset import GraspDataset, SceneGrasps
from dgs_learning.objects.catalogue import SCALES, train_catalogue
from dgs_learning.objects.symmetry import symmetries
from dgs_learning.parallel import Engine
from dgs_learning.synthesis.checkpoint import ChunkFolder, SceneFolder, load_records, save_records
from dgs_learning.synthesis.scenes import make_scene
from dgs_learning.synthesis.sdf import coarse_distance
from dgs_learning.synthesis.stage_one import Effort, GraspRecords, synthesise
from dgs_learning.synthesis.stage_two import ObjectGrasps, valid_in_scene
from dgs_sim_bridge.render.object_model import ObjectModel

Array = NDArray[np.float64]


def record_path(folder: Path, model: ObjectModel) -> Path:
    """Where the grasps of one object at one scale lie."""
    return folder / f"{model.name}.npz"


def _chunk_folder(folder: Path, model: ObjectModel) -> ChunkFolder:
    return ChunkFolder(folder / "chunks" / model.name)


def _one(
    model: ObjectModel, key: list[int], effort: Effort, folder: Path
) -> tuple[ObjectModel, GraspRecords]:
    return model, synthesise(model, key, effort, _chunk_folder(folder, model))


def generate_grasps(
    models: Sequence[tuple[ObjectModel, list[int]]], folder: Path, effort: Effort, engine: Engine
) -> int:
    """Make the grasps of every model that has none in `folder` yet.

    Killed at any time, it loses no more than the chunk that each worker is at.

    Args:
        models: objects with the seed key of each; the key, not the order of work, fixes the grasps.
        folder: one file per finished object appears here, and `chunks/` with those under way.
        effort: when an object is done.
        engine: where the work runs.

    Returns:
        number of grasps made in this call.
    """
    folder.mkdir(parents=True, exist_ok=True)
    todo = [(m, key) for m, key in models if not record_path(folder, m).exists()]
    made, started = 0, time.monotonic()
    results = engine.run(_one, ((m, key, effort, folder) for m, key in todo))
    with tqdm(results, total=len(todo), unit="object", desc="stage 1") as progress:
        for model, records in progress:
            save_records(record_path(folder, model), records)
            _chunk_folder(folder, model).clear()
            made += len(records)
            progress.set_postfix(grasps=made, per_second=f"{made / (time.monotonic() - started):.2f}")
    return made


def restore(dataset: GraspDataset, models: Sequence[ObjectModel], folder: Path) -> int:
    """Lay the grasps of a dataset file out again as `generate_grasps` left them; returns of how many object-scales.

    So a run can go on from a dataset alone: what the file has is not made again.
    """
    number = {model.name: k for k, model in enumerate(dataset.objects)}
    laid_out = 0
    for model in models:
        k = number.get(model.name)
        if k is None or record_path(folder, model).exists():
            continue
        own = slice(dataset.first[k], dataset.first[k + 1])
        drawn, trials = dataset.drawn, dataset.trials
        records = GraspRecords(
            position=dataset.position[own],
            rotation=dataset.rotation[own],
            joints=dataset.joints[own],
            fingers=dataset.fingers[own],
            uniform=dataset.uniform[own],
            drawn=0 if drawn is None else int(drawn[k]),
            trials=0 if trials is None else int(trials[k]),
            seconds=0.0,
        )
        save_records(record_path(folder, model), records)
        laid_out += 1
    return laid_out


def _scene(
    dataset: GraspDataset, seed: int, number: int, limit: int, area: tuple[float, float]
) -> SceneGrasps | None:
    """One scene: draw objects, settle, keep the feasible grasps."""
    key = [seed, number]
    rng = np.random.default_rng(key)
    count = int(rng.integers(5, 16))
    usable = np.flatnonzero(np.diff(dataset.first))
    scene = make_scene(
        dataset.objects, rng.choice(usable, min(count, len(usable)), replace=False).tolist(), key, area
    )
    if len(scene.objects) < 2:
        return None
    expanded, origin = zip(*(expand_by_symmetry(dataset, k, limit, seed) for k in scene.objects), strict=True)
    kept = valid_in_scene(scene, expanded, [coarse_distance(dataset.objects[k]) for k in scene.objects])
    pairs = [own[index] for own, index in zip(origin, kept, strict=True)]
    return SceneGrasps(
        objects=scene.objects,
        T_table_object=scene.T_table_object,
        instance=np.concatenate([np.full(len(index), i) for i, index in enumerate(kept)]),
        grasp=np.concatenate([pair[:, 0] for pair in pairs]),
        symmetry=np.concatenate([pair[:, 1] for pair in pairs]),
    )


def expand_by_symmetry(
    dataset: GraspDataset, number: int, limit: int, seed: int
) -> tuple[ObjectGrasps, NDArray[np.int64]]:
    """Grasps of object `number` times its symmetries, at most `limit` drawn at random.

    Returns:
        G grasps, and (G, 2) of each the index among the object's own grasps and of the symmetry that turned it.
    """
    own = np.arange(dataset.first[number], dataset.first[number + 1])
    turns = symmetries(dataset.objects[number].family)
    pairs = np.stack(np.meshgrid(np.arange(len(own)), np.arange(len(turns)), indexing="ij"), -1).reshape(
        -1, 2
    )
    pairs = np.random.default_rng([seed, number]).permutation(pairs)[:limit]
    index, turn = own[pairs[:, 0]], turns[pairs[:, 1]]
    grasps = ObjectGrasps(
        position=np.einsum("nij,nj->ni", turn, dataset.position[index]),
        rotation=turn @ dataset.rotation[index],
        joints=dataset.joints[index],
        active=dataset.active[index],
    )
    return grasps, pairs


def collect(models: Sequence[ObjectModel], folder: Path) -> GraspDataset:
    """A dataset without scenes from the files that `generate_grasps` left; models without a file are left
    out."""
    found = [m for m in models if record_path(folder, m).exists()]
    records = [load_records(record_path(folder, m)) for m in found]
    return GraspDataset(
        objects=found,
        first=np.concatenate([[0], np.cumsum([len(r) for r in records])]),
        position=np.concatenate([r.position for r in records]),
        rotation=np.concatenate([r.rotation for r in records]),
        joints=np.concatenate([r.joints for r in records]),
        fingers=np.concatenate([r.fingers for r in records]),
        uniform=np.concatenate([r.uniform for r in records]),
        scenes=[],
        drawn=np.array([r.drawn for r in records]),
        trials=np.array([r.trials for r in records]),
    )


def generate_scenes(
    dataset: GraspDataset,
    count: int,
    seed: int,
    engine: Engine,
    folder: Path | None = None,
    limit: int = 600,
    area: tuple[float, float] = (0.6, 0.6),
) -> GraspDataset:
    """The dataset with `count` scenes of 5 to 15 objects; scene k depends on the grasps, the seed and k alone.

    Args:
        dataset: stage 1.
        count: scenes wanted; one in which fewer than two objects come to rest is left out.
        seed: of the scenes.
        engine: where the work runs.
        folder: finished scenes are kept here, so that a killed run goes on where it was.
        limit: grasps per object, symmetric ones included, that are tried in a scene.
        area: x and y extent of the workspace [m].
    """
    store = SceneFolder.of(folder, dataset, [seed, limit], area) if folder else None
    done = {k: store.load(k) for k in range(count) if store.has(k)} if store else {}
    todo = ((dataset, seed, k, limit, area) for k in range(count) if k not in done)
    scenes: list[SceneGrasps | None] = []
    with tqdm(total=count, initial=len(done), unit="scene", desc="stage 2") as progress:
        results = engine.run(_scene, todo, ordered=True)
        for k in range(count):
            if k in done:
                scenes.append(done[k])
                continue
            scenes.append(next(results))
            if store:
                store.save(k, scenes[-1])
            progress.update()
            progress.set_postfix(grasps=sum(len(s.instance) for s in scenes if s))
    return replace(dataset, scenes=[scene for scene in scenes if scene is not None])


def work_list(seed: int, scales: int) -> list[tuple[ObjectModel, list[int]]]:
    """Training objects with `scales` of their five scales each and their seed keys, in a random order of classes.

    The first scale of object k is k mod 5, so that a run with fewer scales is a part of one with more.
    """
    catalogue = train_catalogue()
    order = np.random.default_rng(0).permutation(len(catalogue))
    return [
        (catalogue[k].scaled(SCALES[(k + turn) % 5]), [seed, int(k), int((k + turn) % 5)])
        for turn in range(scales)
        for k in order
    ]
