"""Exported scenes: written, read back, and checked against the dataset and against themselves."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.errors import ErrorCode
from dgs_description.frames import apply, inverse
from dgs_learning.dataset import GraspDataset
from dgs_learning.export import layout
from dgs_learning.export.viewpoints import HIGH, LOW, viewpoints
from dgs_learning.export.write import ExportSettings, export_scenes, export_stage_one
from dgs_learning.parallel import Engine
from dgs_sim_bridge.render.d455 import D455
from dgs_sim_bridge.render.raster import render
from tests.dgs_learning.small_dataset import small_dataset, small_dataset_file
from tests.support.commands import dgs
from tests.support.exported_scene import ExportedScene, read_grasps
from tests.support.refused import refused
from tests.support.stage import NO_NOISE

VIEWS = 3
SETTINGS = ExportSettings(views=VIEWS, points=6000, noise=NO_NOISE)


@pytest.fixture(scope="module")
def data() -> GraspDataset:
    return small_dataset()


def best(data: GraspDataset) -> int:
    """The scene with most grasps."""
    return int(np.argmax([len(s.instance) for s in data.scenes]))


@pytest.fixture(scope="module")
def scene(data: GraspDataset, tmp_path_factory: pytest.TempPathFactory) -> ExportedScene:
    number = best(data)
    (path,) = export_scenes(data, [number], tmp_path_factory.mktemp("export"), SETTINGS, Engine(1))
    assert path.name == f"scene_{number:04d}"
    return ExportedScene(path)


def test_folder_has_the_layout_of_the_release(scene: ExportedScene) -> None:
    names = {path.name for path in scene.path.iterdir()}
    texts = {"cam_extrinsic.txt", "cam_info.txt", "grasp_labels.txt", "obj_info.txt", "visible_mask.txt"}
    assert names == {"rgb", "depth", "pointcloud", "segn", "grasp"} | texts
    for folder, suffix in layout.FOLDERS.items():
        assert sorted(p.name for p in (scene.path / folder).iterdir()) == [
            f"{k:04d}.{suffix}" for k in range(VIEWS)
        ]


def test_objects_camera_and_grasps_come_back(scene: ExportedScene, data: GraspDataset) -> None:
    stored = data.scenes[best(data)]
    assert scene.camera == D455 and len(scene.T_table_camera) == VIEWS
    for words, k, T in zip(scene.objects, stored.objects, stored.T_table_object, strict=True):
        (name, shape_class, _, scale), (_, *pose) = words[:4], map(float, words[4:])
        model = data.objects[k]
        assert f"{name}@{scale}" == model.name and shape_class == model.shape_class
        assert np.allclose(pose[:3], T[:3, 3], atol=1e-6)
        assert np.allclose(Rotation.from_quat(pose[3:]).as_matrix(), T[:3, :3], atol=1e-5)
    grasps = data.scene_grasps(stored)
    assert np.array_equal(scene.grasps.instance, stored.instance)
    assert np.array_equal(scene.grasps.symmetry, stored.symmetry) and scene.grasps.symmetry.max() > 0
    assert np.allclose(scene.grasps.position, grasps.position, atol=1e-6)
    assert np.allclose(Rotation.from_quat(scene.grasps.quaternion).as_matrix(), grasps.rotation, atol=1e-5)
    assert np.allclose(scene.grasps.j_end, grasps.grasp_joints, atol=1e-6)
    assert np.array_equal(scene.grasps.fingers, grasps.active_fingers.sum(1))
    five = scene.grasps.fingers == 5
    assert np.allclose(scene.grasps.j_init[five, 1::4], 0.6 * scene.grasps.j_end[five, 1::4], atol=1e-5)


def test_depth_mask_and_cloud_agree(scene: ExportedScene, data: GraspDataset) -> None:
    stored = data.scenes[best(data)]
    models = [data.objects[k] for k in stored.objects]
    for number in range(VIEWS):
        view = scene.view(number)
        ideal = render([m.mesh for m in models], stored.T_table_object, D455, view.T_table_camera)
        on_object = view.segn >= layout.SEGN_FIRST_OBJECT
        assert np.array_equal(on_object, ideal.ids >= 0)
        assert np.abs(view.depth - ideal.depth)[on_object].max() < 0.0006
        assert np.array_equal(view.segn[on_object] - layout.SEGN_FIRST_OBJECT, ideal.ids[on_object])
        pixel = np.rint(D455.project(view.points)).astype(int)
        assert np.allclose(view.depth[pixel[:, 1], pixel[:, 0]], view.points[:, 2], atol=0.0006)
        segment = view.segn[pixel[:, 1], pixel[:, 0]].astype(int)
        assert np.array_equal(
            np.where(segment == layout.SEGN_TABLE, -1, segment - layout.SEGN_FIRST_OBJECT), view.instance
        )
        assert len(view.points) <= 6000 and view.rgb.shape == (480, 848, 3)
        assert view.rgb[on_object].std() > 5


def test_grasps_of_a_view_are_those_of_the_table(scene: ExportedScene) -> None:
    labelled = 0
    for number in range(VIEWS):
        view = scene.view(number)
        labelled += len(view.grasp)
        position = apply(inverse(view.T_table_camera), scene.grasps.position[view.grasp])
        assert np.allclose(view.position, position, atol=1e-4)
        turn = inverse(view.T_table_camera)[:3, :3]
        rotation = turn @ Rotation.from_quat(scene.grasps.quaternion[view.grasp]).as_matrix()
        assert np.allclose(view.rotation, rotation, atol=1e-4)
        assert np.allclose(view.points[view.point] + view.offset, view.position, atol=1e-6)
        assert np.allclose(view.j_end, scene.grasps.j_end[view.grasp], atol=1e-5)
        assert np.allclose(view.j_init, scene.grasps.j_init[view.grasp], atol=1e-5)
        assert (view.label[view.point] == 2).all()
        assert np.array_equal(view.instance[view.point], scene.grasps.instance[view.grasp])
        assert set(np.unique(view.label)) <= {0, 1, 2} and (view.instance[view.label > 0] >= 0).all()
        # The reference point is the nearest visible point of the object (section V-B).
        for g, row in zip(view.grasp, view.point, strict=True):
            own = view.points[view.instance == scene.grasps.instance[g]]
            tcp = apply(inverse(view.T_table_camera), scene.grasps.position[g : g + 1])[0]
            nearest = np.linalg.norm(own - tcp, axis=1).min()
            assert np.linalg.norm(view.points[row] - tcp) == pytest.approx(nearest, abs=1e-4)
    assert labelled > 0


def test_visibility_is_the_seen_share_of_the_silhouette(scene: ExportedScene) -> None:
    assert scene.visible.shape == (VIEWS, len(scene.objects))
    assert ((scene.visible >= 0) & (scene.visible <= 1)).all()
    for number in range(VIEWS):
        seen = [
            (scene.view(number).segn == layout.SEGN_FIRST_OBJECT + k).any() for k in range(len(scene.objects))
        ]
        assert np.array_equal(scene.visible[number] > 0, seen)
    assert scene.visible.max() > 0.99


def test_viewpoints_fill_the_papers_band_evenly() -> None:
    eyes = np.array([T[:3, 3] for T in viewpoints(256)])
    assert np.allclose(np.linalg.norm(eyes, axis=1), 1.0)
    elevation = np.arcsin(eyes[:, 2])
    assert elevation.min() > LOW and elevation.max() < HIGH
    assert np.linalg.norm(eyes[:, :2].mean(0)) < 0.01
    nearest = np.sort(np.linalg.norm(eyes[:, None] - eyes[None], axis=-1), axis=1)[:, 1]
    assert nearest.min() > 0.5 * nearest.mean()
    for T in viewpoints(5):
        assert np.allclose(apply(inverse(T), np.zeros((1, 3))), [[0, 0, 1]], atol=1e-9), "looks at the centre"


def test_finished_scenes_stay_and_other_settings_are_refused(data: GraspDataset, tmp_path: Path) -> None:
    settings = ExportSettings(views=1, points=500)
    assert len(list(export_scenes(data, [0, 1], tmp_path, settings, Engine(1)))) == 2
    (tmp_path / "scene_0001").rename(tmp_path / "scene_0001.partial")  # as a kill leaves it
    assert [p.name for p in export_scenes(data, [0, 1], tmp_path, settings, Engine(1))] == ["scene_0001"]
    with refused(ErrorCode.REQUEST_INVALID, "other settings.*: views 1 instead of 2"):
        list(export_scenes(data, [0], tmp_path, ExportSettings(views=2, points=500), Engine(1)))


def test_a_scene_that_hardly_stands_out_of_the_table_is_exported_too(
    data: GraspDataset, tmp_path: Path
) -> None:
    scene = data.scenes[best(data)]
    heights = [
        apply(T, data.objects[k].vertices)[:, 2].max()
        for k, T in zip(scene.objects, scene.T_table_object, strict=True)
    ]
    sunk = scene.T_table_object.copy()
    sunk[:, 2, 3] -= np.array(heights) - 0.004
    low = replace(data, scenes=[replace(scene, T_table_object=sunk)])
    (path,) = export_scenes(low, [0], tmp_path, replace(SETTINGS, views=1), Engine(1))
    assert len(ExportedScene(path).view(0).points) == SETTINGS.points


def test_stage_one_is_sorted_by_class_object_and_scale(data: GraspDataset, tmp_path: Path) -> None:
    assert export_stage_one(data, tmp_path) == 2
    grasps = read_grasps(tmp_path / "cylinder" / "can_056" / "1.00.txt")
    assert len(grasps.fingers) == data.first[2] - data.first[1]
    assert np.allclose(grasps.position, data.grasps.position[data.first[1] :], atol=1e-6)


def test_names_of_several_words_are_one_word_in_tables_and_paths(data: GraspDataset, tmp_path: Path) -> None:
    mug = replace(data.objects[0], name="coffee mug/2@1.00", family="coffee mug")
    layout.write_objects(tmp_path, [mug], np.eye(4)[None])
    row = (tmp_path / "obj_info.txt").read_text().splitlines()[1].split()
    assert len(row) == 13 and (row[1], row[3], row[4]) == ("coffee_mug_2", "coffee_mug", "1.00")
    export_stage_one(replace(data, objects=[mug, data.objects[1]]), tmp_path)
    assert (tmp_path / mug.shape_class / "coffee_mug_2" / "1.00.txt").is_file()


def test_command_checks_the_range(tmp_path: Path) -> None:
    words = ["export", "--dataset", str(small_dataset_file()), "--out", str(tmp_path), "--workers", "1"]
    dgs([*words, "--scenes", "0", "--views", "1"])
    assert (tmp_path / "scene_0000" / "rgb" / "0000.png").is_file()
    assert "not within" in dgs([*words, "--scenes", "5-400"], 2).output
