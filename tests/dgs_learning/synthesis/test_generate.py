"""Stage 1 and 2 on real processes: the same result on any number of workers and engines, and after kill -9."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_learning.dataset import (
    GUIDED,
    GraspDataset,
    finger_pattern,
    load_dataset,
    object_grasps,
    save_dataset,
)
from dgs_learning.objects import shapes
from dgs_learning.parallel import Engine
from dgs_learning.synthesis import generate
from dgs_learning.synthesis.generate import (
    collect,
    expand_by_symmetry,
    generate_grasps,
    generate_scenes,
    load_grasps,
    record_path,
    restore,
    vary_grasps,
    with_scenes_of,
    work_list,
)
from dgs_learning.synthesis.stage_one import Effort, ObjectGrasps, resting_ups
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts
from tests.support.commands import dgs
from tests.support.environment import REPO_ROOT
from tests.support.refused import refused

EFFORT = Effort(target=4, max_chunks=1, draws=40)


def tiny_objects() -> list[tuple[ObjectModel, list[int]]]:
    """Two discs: each rests on two faces only, so it takes few chunks."""
    disc = from_parts("disc", "cylinder", "disc", shapes.lathe([(0.031, 0), (0.03, 0.03)]), 0.1)
    puck = from_parts("puck", "cylinder", "puck", shapes.lathe([(0.026, 0), (0.025, 0.034)]), 0.1)
    return [(disc, [5, 0, 0]), (puck, [5, 1, 0])]


def same(a: ObjectGrasps, b: ObjectGrasps) -> bool:
    pairs = zip(vars(a.grasps).values(), vars(b.grasps).values(), strict=True)
    return (a.drawn, a.trials) == (b.drawn, b.trials) and all(np.array_equal(x, y) for x, y in pairs)


def found_in(folder: Path) -> list[ObjectGrasps]:
    files = [record_path(folder, model) for model, _ in tiny_objects()]
    return [load_grasps(file) for file in files if file.exists()]


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one worker makes of the first object in one go."""
    folder = tmp_path_factory.mktemp("first")
    made = generate_grasps(tiny_objects()[:1], folder, EFFORT, Engine(1))
    found = load_grasps(record_path(folder, tiny_objects()[0][0]))
    assert made == len(found.grasps) >= 1 and found.trials >= 4
    assert not list(folder.glob("chunks/*")), "chunks of finished objects are cleared"
    return folder


def test_finished_objects_are_not_made_again(first: Path) -> None:
    assert generate_grasps(tiny_objects()[:1], first, EFFORT, Engine(1)) == 0


def test_variations_are_added_to_a_finished_object_once(first: Path, tmp_path: Path) -> None:
    shutil.copytree(first, tmp_path, dirs_exist_ok=True)
    objects, before = tiny_objects(), found_in(first)[0]
    wanted = len(before.grasps) + 2
    made = vary_grasps(objects, tmp_path, replace(EFFORT, max_chunks=4, varied=wanted), Engine(1))
    after = found_in(tmp_path)
    assert len(after) == 1 and len(after[0].grasps) == len(before.grasps) + made >= wanted
    assert vary_grasps(objects, tmp_path, replace(EFFORT, max_chunks=4, varied=wanted), Engine(1)) == 0


@pytest.mark.slow
def test_same_grasps_on_two_workers(first: Path, tmp_path: Path) -> None:
    generate_grasps(tiny_objects()[:1], tmp_path, EFFORT, Engine(2))
    assert same(found_in(first)[0], found_in(tmp_path)[0])


def test_missing_engine_is_named_in_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with refused(ErrorCode.REQUEST_INVALID, "pip install distributed"):
        generate_grasps(tiny_objects(), tmp_path, EFFORT, Engine(2, "dask"))


KILLED_RUN = """
import sys
from pathlib import Path
from tests.dgs_learning.synthesis.test_generate import EFFORT, tiny_objects
from dgs_learning.parallel import Engine
from dgs_learning.synthesis.generate import generate_grasps

generate_grasps(tiny_objects()[:1], Path(sys.argv[1]), EFFORT, Engine(1))
"""


def test_kill_nine_loses_only_the_chunk_under_way(
    first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, _ = tiny_objects()[0]

    def finished() -> list[Path]:
        return list((tmp_path / "chunks" / record_path(tmp_path, model).stem).rglob("output.pkl"))

    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(REPO_ROOT), *filter(None, sys.path)])}
    process = subprocess.Popen([sys.executable, "-c", KILLED_RUN, str(tmp_path)], env=environment)
    try:
        deadline = time.monotonic() + 100
        while not finished() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.005)
    finally:
        process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL, "the run ended before it could be killed"
    kept = {path: path.stat().st_mtime_ns for path in finished()}
    assert kept and not record_path(tmp_path, model).exists()

    monkeypatch.setattr(shutil, "rmtree", lambda *_, **__: None)
    generate_grasps(tiny_objects()[:1], tmp_path, EFFORT, Engine(1))
    assert same(load_grasps(record_path(tmp_path, model)), load_grasps(record_path(first, model)))
    assert len(finished()) == len(resting_ups(model, 5)), "one chunk of each pose"
    assert kept.items() <= {path: path.stat().st_mtime_ns for path in finished()}.items(), "made again"


def grasp_dataset() -> GraspDataset:
    """Two objects with one grasp each, from above."""
    return GraspDataset(
        objects=[model for model, _ in tiny_objects()],
        first=np.array([0, 1, 2]),
        grasps=object_grasps(
            np.tile([0.0, 0.0, 0.05], (2, 1)),
            np.tile(np.diag([1.0, -1.0, -1.0]), (2, 1, 1)),
            np.tile([0.0, 0.4, 0.3, 0.3], (2, 5)),
            finger_pattern([5, 5]),
            np.array([GUIDED, GUIDED]),
        ),
        friction=np.array([0.4, 0.6]),
        gap=np.full((2, 5), np.nan),
        scenes=[],
        drawn=np.array([10, 10]),
        trials=np.array([1, 1]),
    )


def test_an_imported_box_is_not_turned_like_the_family_of_its_name() -> None:
    data = grasp_dataset()
    for shape, turns in ((shapes.box([0.04, 0.09, 0.03]), 1), (shapes.lathe([(0.03, 0), (0.03, 0.1)]), 36)):
        model = from_parts("can", "cuboid", "can", shape, 0.1)
        pairs = expand_by_symmetry(replace(data, objects=[model, model]), 0, 100, 0)[1]
        assert len(pairs) == turns


def test_scenes_of_a_run_that_was_cut_short_are_kept(tmp_path: Path) -> None:
    whole = generate_scenes(grasp_dataset(), 3, 0, Engine(1))
    generate_scenes(grasp_dataset(), 2, 0, Engine(1), tmp_path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("output.pkl")}
    again = generate_scenes(grasp_dataset(), 3, 0, Engine(1), tmp_path)
    assert len(before) == 2 and all(path.stat().st_mtime_ns == stamp for path, stamp in before.items())
    assert len(again.scenes) == len(whole.scenes) >= 1
    for a, b in zip(whole.scenes, again.scenes, strict=True):
        assert np.array_equal(a.T_table_object, b.T_table_object) and np.array_equal(a.grasp, b.grasp)


def test_scenes_of_uncommitted_code_are_not_taken_for_those_of_other_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DGS_DATA_DIR", str(tmp_path))
    monkeypatch.setattr(generate, "work_list", lambda *_: [])
    monkeypatch.setattr(generate, "collect", lambda *_: grasp_dataset())
    for made_by, kept in (("changed+", 0), ("committed", 1)):
        monkeypatch.setattr("dgs_description.paths.revision", lambda made_by=made_by: made_by)
        dgs(["scenes", "--count", "1", "--workers", "1", "--out", str(tmp_path / "mine.npz")])
        assert len(list(tmp_path.rglob("output.pkl"))) == kept


def test_scenes_of_other_grasps_are_not_mixed_in(tmp_path: Path) -> None:
    generate_scenes(grasp_dataset(), 1, 0, Engine(1), tmp_path)
    other = grasp_dataset()
    other.grasps.position[0] += 0.001
    generate_scenes(other, 1, 0, Engine(1), tmp_path)
    assert len(list(tmp_path.rglob("output.pkl"))) == 2


def test_new_scenes_are_no_copies_of_those_that_are_there() -> None:
    grown = generate_scenes(generate_scenes(grasp_dataset(), 3, 0, Engine(1)), 3, 0, Engine(1))
    poses = [scene.T_table_object.tobytes() for scene in grown.scenes]
    assert len(set(poses)) == len(poses) > 3


def test_scenes_are_kept_where_a_dataset_has_grown() -> None:
    few = generate_scenes(grasp_dataset(), 2, 0, Engine(1))
    order = [1, 0]
    turned = replace(few, objects=[few.objects[k] for k in order], grasps=few.grasps[order], scenes=[])
    grown = generate_scenes(with_scenes_of(turned, few), 2, 0, Engine(1))
    assert len(grown.scenes) > len(few.scenes) >= 1
    for a, b in zip(few.scenes, grown.scenes, strict=False):
        assert [few.objects[k].name for k in a.objects] == [grown.objects[k].name for k in b.objects]
        np.testing.assert_array_equal(few.scene_grasps(a).pose, grown.scene_grasps(b).pose)
    with refused(ErrorCode.REQUEST_INVALID, "no grasps of puck"):
        with_scenes_of(replace(few, objects=few.objects[:1]), few)


def test_scenes_are_not_kept_for_other_grasps(tmp_path: Path) -> None:
    own = grasp_dataset()
    save_dataset(tmp_path / "known.npz", own)
    known = load_dataset(tmp_path / "known.npz")
    assert with_scenes_of(own, known).objects == own.objects, "quantised ones are the same"
    for rows, name in (([0], "disc"), ([1], "puck")):
        other = grasp_dataset()
        other.grasps.position[rows] += 0.001
        for mixed in (other, own.without(rows)):
            with refused(ErrorCode.REQUEST_INVALID, f"{name} do not begin as known"):
                with_scenes_of(mixed, known)


def test_a_dataset_file_alone_is_enough_to_go_on_from(tmp_path: Path) -> None:
    models = [model for model, _ in tiny_objects()]
    save_dataset(tmp_path / "first.npz", grasp_dataset())
    packed = load_dataset(tmp_path / "first.npz")
    assert restore(packed, models, tmp_path / "stage1") == len(models)
    assert restore(packed, models, tmp_path / "stage1") == 0, "what is there was written again"
    assert generate_grasps(tiny_objects(), tmp_path / "stage1", EFFORT, Engine(1)) == 0
    again = collect(models, tmp_path / "stage1")
    save_dataset(tmp_path / "second.npz", again)
    with np.load(tmp_path / "first.npz") as a, np.load(tmp_path / "second.npz") as b:
        for name in ("first", "grasp_position", "grasp_rotation", "grasp_joints", "grasp_fingers"):
            np.testing.assert_array_equal(a[name], b[name])


def test_another_shape_of_the_same_name_is_another_object(tmp_path: Path) -> None:
    data, (disc, puck) = grasp_dataset(), (model for model, _ in tiny_objects())
    wide = replace(disc, vertices=1.1 * disc.vertices, parts=tuple(1.1 * part for part in disc.parts))
    assert restore(data, [wide, puck], tmp_path) == 1 and not record_path(tmp_path, wide).exists()
    assert restore(data, [disc], tmp_path) == 1 and collect([wide, puck], tmp_path).objects == [puck]
    with refused(ErrorCode.REQUEST_INVALID, "disc had another shape"):
        with_scenes_of(replace(data, objects=[wide, puck]), data)
    generate_scenes(data, 1, 0, Engine(1), tmp_path)
    generate_scenes(replace(data, objects=[wide, puck]), 1, 0, Engine(1), tmp_path)
    assert len(list(tmp_path.rglob("output.pkl"))) == 2
    with refused(ErrorCode.REQUEST_INVALID, "two objects are named disc"):
        work_list(0, 1, [disc, wide])


def test_other_objects_leave_the_catalogues_keys_alone():
    disc = tiny_objects()[0][0]
    alone, more = (
        {model.name: key for model, key in work_list(3, 2, others)} for others in ([], [disc, disc.scaled(2)])
    )
    assert alone.items() <= more.items()
    added = {name: key for name, key in more.items() if name not in alone}
    assert len(added) == 4 and all(name.startswith("disc") for name in added)
    assert len({tuple(key) for key in more.values()}) == len(more)
