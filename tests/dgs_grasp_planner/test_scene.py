"""Wishes of a request, and what a scene makes of its cloud."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.errors import ErrorCode
from dgs_description.frames import transform
from dgs_description.hand import HAND
from dgs_grasp_planner.scene import VOXEL, PlanRequest, Region, Scene, prepare
from tests.dgs_description.test_grasp import _some as some
from tests.dgs_grasp_planner.contact.test_height_field import BOX
from tests.dgs_grasp_planner.scenes import CAMERA, field_of, table_scene
from tests.support.refused import refused

NONE = np.zeros((0, 3))


def test_region_is_a_turned_box() -> None:
    turn = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    region = Region(transform(turn, (1.0, 0.0, 0.0)), np.array([2.0, 0.2, 0.2]))
    points = np.array([[1.0, 0, 0], [1.6, 0.6, 0], [1.6, -0.6, 0], [1.0, 0, 0.11], [1.8, 0.8, 0]])
    assert region.contains(points).tolist() == [True, True, False, False, False]


def test_a_box_is_entered_on_the_way_too() -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        place = transform(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.4, 0.4, 3))
        box = Region(place, rng.uniform(0.01, 0.2, 3))
        points, margin = rng.uniform(-0.3, 0.3, (20, 15, 3)), rng.uniform(0.0, 0.02, (15, 1))
        way = rng.uniform(-0.3, 0.3, (20, 3)) * (rng.random((20, 1)) < 0.7)
        wider = Region(place, box.size + 2 * margin[0])
        wanted = np.any(
            [wider.contains(points[:, 0] + share * way) for share in np.linspace(0.0, 1.0, 400)], axis=0
        )
        np.testing.assert_array_equal(box.entered(points[:, :1], way, margin[:1]), wanted)
        alone = [box.entered(points[:, [k]], way, margin[[k]]) for k in range(15)]
        np.testing.assert_array_equal(box.entered(points, way, margin), np.any(alone, axis=0))


def test_what_is_wished_is_admitted() -> None:
    grasps = replace(some(5), active_fingers=np.ones((5, HAND.finger_count), bool))
    assert len(PlanRequest().admitted(grasps, NONE)) == 5
    limit = float(np.median(grasps.score))
    assert (PlanRequest(min_score=limit).admitted(grasps, NONE).score >= limit).all()
    pushes = replace(grasps, active_fingers=np.zeros((5, HAND.finger_count), bool))
    assert len(PlanRequest(min_score=1.0).admitted(pushes, grasps.reference_point)) == 5
    here = Region(transform(np.eye(3), grasps.reference_point[2]), np.full(3, 1e-3))
    np.testing.assert_array_equal(
        PlanRequest(region=here).admitted(grasps, NONE).position, grasps.position[[2]]
    )


def test_what_is_too_small_for_a_shape_is_grasped_by_its_voxels() -> None:
    grasps = replace(some(5), active_fingers=np.ones((5, HAND.finger_count), bool))
    aimed = PlanRequest(things=grasps.reference_point[[2]])
    elsewhere = field_of(BOX + (0.5, 0.5, 0.0))
    found = aimed.admitted(grasps, NONE, elsewhere)
    np.testing.assert_array_equal(found.position, grasps.position[[2]])


def test_what_no_score_changes_is_made_once() -> None:
    scene = Scene(table_scene(1), np.array(CAMERA), np.random.default_rng(0))
    asked: list[float | None] = []

    def make(scene: Scene) -> int:
        asked.append(scene.request.min_score)
        return len(asked)

    assert scene.once(make) == 1 and scene.asked(0.3).once(make) == 1
    assert asked == [None]


def test_a_scene_keeps_points_near_objects_and_one_mean_per_voxel() -> None:
    cloud = table_scene(1)
    scene = prepare(cloud, CAMERA, np.random.default_rng(0), PlanRequest())
    assert len(scene.points) <= 20_000 and (scene.points[:, 2] > 0.01).any()
    high = scene.points[scene.points[:, 2] > scene.object_height]
    cells = np.unique(np.floor(high / VOXEL).astype(int), axis=0)
    assert len(scene.voxels) == len(cells)
    np.testing.assert_array_equal(
        np.unique(np.floor(scene.voxels / VOXEL).astype(int), axis=0), cells, "means lie in their cells"
    )
    assert scene.field is scene.field
    assert list(scene.clock.times) == ["prepare", "height_field"]


def test_a_scene_in_which_nothing_stands_has_no_field() -> None:
    bare = Scene(table_scene(objects=0), CAMERA, np.random.default_rng(0))
    with refused(ErrorCode.NO_OBJECTS):
        _ = bare.field


def seen(request: PlanRequest = PlanRequest()) -> Scene:
    return prepare(table_scene(1), CAMERA, np.random.default_rng(0), request)


def test_a_target_means_the_whole_thing_it_lies_on_and_no_other() -> None:
    everything = seen().voxels
    aim = everything[np.argmax(everything[:, 2])]
    request = seen(PlanRequest(targets=aim[None])).request
    assert request.things is not None
    assert 20 < len(request.things) < 0.5 * len(everything)
    assert np.ptp(request.things[:, :2], axis=0).max() < 0.12, "one of the things, which are 15 cm apart"
    beside = np.linalg.norm(everything - aim, axis=1) > 0.14
    assert request.wanted(request.things).all()
    assert not request.wanted(everything[beside]).any()


def test_two_targets_mean_two_things() -> None:
    everything = seen().voxels
    first = everything[np.argmin(everything[:, 1])]
    second = everything[np.argmax(everything[:, 1])]
    both = seen(PlanRequest(targets=np.array([first, second]))).request.things
    alone = [seen(PlanRequest(targets=aim[None])).request.things for aim in (first, second)]
    assert both is not None and len(both) == sum(len(thing) for thing in alone if thing is not None)


@pytest.mark.parametrize(("x", "words"), [(0.0, r"\d mm away"), (1e300, "more than 10 m away")])
def test_a_target_where_nothing_stands_is_refused(x: float, words: str) -> None:
    with refused(ErrorCode.NO_OBJECTS, words):
        seen(PlanRequest(targets=np.array([[x, 0.39, 0.0]])))


def test_nothing_is_wanted_in_a_box_to_keep_out_of() -> None:
    box = Region(transform(position=(0.1, 0.0, 0.0)), np.array([0.2, 0.2, 0.4]))
    request = PlanRequest(keep_out=(box,))
    assert request.wanted(np.array([[0.1, 0.0, 0.1], [0.3, 0.0, 0.1]])).tolist() == [False, True]
