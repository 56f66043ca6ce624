"""Scenes settle on the table, and keep no grasp that cuts it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dgs_description.frames import apply, transform
from dgs_description.hand import HAND
from dgs_learning.objects import shapes
from dgs_learning.synthesis.scenes import Scene, make_scene
from dgs_learning.synthesis.stage_two import valid_in_scene
from dgs_sim_bridge.render.object_model import from_parts


def test_scene_settles_on_the_table_and_repeats(block):
    tall = from_parts("can", "cylinder", "can", shapes.lathe([(0.03, 0), (0.03, 0.1)]), 0.2)
    a, b = (make_scene([block, tall], [0, 1, 0], [7, 1], (0.4, 0.4)) for _ in range(2))
    assert np.array_equal(a.T_table_object, b.T_table_object)
    assert len(a.objects) >= 2
    for k, T in zip(a.objects, a.T_table_object, strict=True):
        lowest = ([block, tall][k].vertices @ T[:3, :3].T + T[:3, 3])[:, 2].min()
        assert -0.002 < lowest < 0.003


def test_scene_keeps_no_grasp_through_the_table(block, sdf, found):
    grasps = found.grasps
    scene = make_scene([block], [0], [1, 1], (0.4, 0.4))
    (kept,) = valid_in_scene(scene, [grasps], [sdf])
    T = scene.T_table_object[0]
    for i in kept:
        world = apply(T @ grasps[i].pose, HAND.finger_spheres(grasps[i].grasp_joints).reshape(-1, 3))
        assert (world[:, 2] - np.tile(HAND.sphere_radii, 5)).min() > 0
    upside_down = replace(grasps, rotation=np.tile(T[:3, :3].T, (len(grasps), 1, 1)))
    (none,) = valid_in_scene(scene, [upside_down], [sdf])
    assert not len(none), "a hand that comes from below the table was kept"
    beside = transform(position=(0.07, 0.0, 0.0)) @ T
    crowded = Scene(np.zeros(2, int), np.stack([T, beside]))
    free, _ = valid_in_scene(crowded, [grasps, grasps[:0]], [sdf, sdf])
    assert len(free) < len(kept), "a hand that cuts the object beside was kept"
