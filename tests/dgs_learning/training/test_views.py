"""Views that the network is trained on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dgs_description.frames import apply, transform
from dgs_grasp_planner.preprocess import prepare_rows
from dgs_learning.objects import shapes
from dgs_learning.training import views
from dgs_learning.training.views import LEFT, MARGIN, View, ViewSettings, ViewSource, capture, window
from dgs_sim_bridge.render.d455 import D455
from dgs_sim_bridge.render.object_model import from_parts
from tests.dgs_learning.tiny_dataset import tiny_dataset


def test_a_window_of_the_image_shows_the_same_objects_from_the_same_place() -> None:
    data = tiny_dataset()
    scene, counts = data.scenes[0], []
    models = [data.objects[k] for k in scene.objects]
    for whole in (True, False):
        rng, settings = np.random.default_rng(5), ViewSettings()
        view = capture(models, scene.T_table_object, rng, settings, whole=whole)
        near = prepare_rows(view.points, rng)
        found = np.bincount(view.instance[near] + 1, minlength=len(models) + 1)
        counts.append((found, view.camera, view.points[view.instance >= 0].mean(axis=0)))
    (full, from_there, middle), (part, from_here, same_middle) = counts
    assert np.array_equal(from_there, from_here)
    np.testing.assert_allclose(part[1:], full[1:], rtol=0.1, atol=30)
    assert 500 < part[0] <= full[0] * 1.1, "of the table, what lies around the objects"
    np.testing.assert_allclose(same_middle, middle, atol=2e-3)


def test_some_views_are_of_the_whole_image_and_all_where_the_table_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole: list[bool] = []

    def noted(*args: Any, **options: bool) -> View:
        whole.append(options["whole"])
        return capture(*args, **options)

    monkeypatch.setattr(views, "capture", noted)
    for keep_table in (False, True):
        source = ViewSource(tiny_dataset(), 0, keep_table)
        for number in range(5):
            source.view(0, number)
    assert whole == [True, False, False, False, True] + [True] * 5


def test_things_too_thin_to_stand_out_are_views_of_the_whole_table() -> None:
    data = tiny_dataset(1)
    sheets = [
        from_parts(name, "cuboid", name, shapes.box([0.15, 0.1, 0.003]), 0.1) for name in ("one", "two")
    ]
    poses = np.array([transform(position=(x, 0.0, 0.0015)) for x in (-0.1, 0.1)])
    flat = replace(data, objects=sheets, scenes=[replace(data.scenes[0], T_table_object=poses)])
    views = [ViewSource(flat, 0).view(0, number) for number in range(4)]
    assert min(len(view.points) for view in views) > 5000
    assert all(set(view.instance) >= {0, 1} for view in views)


@pytest.mark.parametrize("place", [(0.0, 0.0, 1.0), (0.5, 0.2, 1.2), (-3.0, 0.0, 1.0)])
def test_a_window_sees_its_points_where_the_whole_image_does(place: tuple[float, float, float]) -> None:
    points = apply(transform(position=place), np.random.default_rng(0).uniform(-0.05, 0.05, (50, 3)))
    part = window(D455, points)
    assert 0 < part.width <= D455.width and 0 < part.height <= D455.height
    assert 0 <= part.cx <= part.width and 0 <= part.cy <= part.height
    shift = D455.project(points) - part.project(points)
    assert np.ptp(shift, axis=0).max() < 1e-9 and np.array_equal(shift[0], np.rint(shift[0]))
    seen = (D455.project(points) >= 0).all(axis=1) & (D455.project(points) < (D455.width, D455.height)).all(
        axis=1
    )
    assert (part.project(points)[seen] >= 0).all()
    assert (part.project(points)[seen] < (part.width, part.height)).all()
    if seen.all() and D455.project(points)[:, 0].min() > LEFT:
        assert (
            part.project(points)[:, 0].min() >= LEFT
            and part.project(points)[:, 1].max() < part.height - MARGIN + 1
        )
