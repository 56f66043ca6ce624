"""Penetration depth and volume against closed forms and a fine voxel sum."""

from __future__ import annotations

import numpy as np
import pytest

from dgs_description.frames import transform
from dgs_description.hand import HAND
from dgs_learning.evaluation.penetration import SAMPLE, PenetrationMeter, hand_parts, solid_of
from dgs_learning.objects import shapes
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts

OPEN = np.zeros(20)
AT_ORIGIN = np.eye(4)


def block(size: tuple[float, float, float]) -> ObjectModel:
    return from_parts(f"block{size}", "cuboid", "block", shapes.box(list(size)), 0.1)


def middle_tip() -> np.ndarray:
    """(3,) the outermost point of the middle finger's distal capsule, open hand, in `hand_tcp`."""
    capsule = HAND.capsules[0][2]
    T_tcp_distal = HAND.link_frames(OPEN)[2, 3]
    end = T_tcp_distal @ np.array([0.0, capsule.end, capsule.height, 1.0])
    return end[:3] + capsule.radius * T_tcp_distal[:3, 1]


def test_capsules_have_the_volume_of_round_ones_within_the_stated_error() -> None:
    volumes = [part.volume() for part in hand_parts(OPEN)[-15:]]
    exact = [np.pi * c.radius**2 * (c.end - c.start) + 4 / 3 * np.pi * c.radius**3 for c in HAND.capsules[0]]
    share = np.array(volumes).reshape(5, 3) / exact
    assert (share < 1.0).all()
    assert (share > 0.993).all()


@pytest.mark.parametrize("depth", [0.001, 0.003, 0.006])
def test_a_fingertip_pushed_into_a_wall(depth: float) -> None:
    """Only the middle fingertip reaches: the intersection is a spherical cap."""
    tip = middle_tip()
    assert tip[2] - np.delete(HAND.fingertips(OPEN)[:, 2], 2).max() > 0.001
    wall = block((0.004, 0.004, 0.05)) if depth < 0.002 else block((0.02, 0.02, 0.05))
    T = transform(position=(tip[0], tip[1], tip[2] + 0.025 - depth))
    found = PenetrationMeter()(OPEN, AT_ORIGIN, [wall], [T])
    radius = HAND.capsules[0][2].radius
    assert found.depth_mm == pytest.approx(depth * 1e3, abs=0.1)
    if depth >= 0.002:
        cap = np.pi * depth**2 * (radius - depth / 3)
        assert found.volume_mm3 == pytest.approx(cap * 1e9, rel=0.03)


def test_a_finger_through_a_plate_is_as_deep_as_half_of_it_is_thick() -> None:
    """All corners of what they share lie on the plate's faces."""
    tip = middle_tip()
    plate = transform(position=(tip[0], tip[1], tip[2] - 0.012))
    found = PenetrationMeter()(OPEN, AT_ORIGIN, [block((0.03, 0.03, 0.004))], [plate])
    assert found.depth_mm == pytest.approx(2.0, abs=SAMPLE / 2 * 1e3)


def test_volume_agrees_with_a_voxel_sum() -> None:
    """A closing hand pushed deep into a block, against cells of 1 mm of the same capsules and boxes."""
    half, step = 0.03, 0.001
    joints = np.tile([0.0, 0.6, 0.5, 0.5], 5)
    T_table_block = transform(position=(0.01, 0.0, 0.03))
    found = PenetrationMeter()(joints, AT_ORIGIN, [block((2 * half,) * 3)], [T_table_block])
    axis = np.arange(-half + step / 2, half, step)
    inside = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3) + T_table_block[:3, 3]
    covered = np.zeros(len(inside), bool)
    for finger in HAND.link_frames(joints)[:, 1:]:
        for capsule, T_tcp_link in zip(HAND.capsules[0], finger, strict=True):
            local = (inside - T_tcp_link[:3, 3]) @ T_tcp_link[:3, :3]
            along = np.clip(local[:, 1], capsule.start, capsule.end)
            gap = local - np.stack([0 * along, along, 0 * along + capsule.height], -1)
            covered |= (gap**2).sum(1) < capsule.radius**2
    for box in HAND.palm_boxes:
        low, high = box[0::2] - HAND.T_base_tcp[:3, 3], box[1::2] - HAND.T_base_tcp[:3, 3]
        covered |= ((inside > low) & (inside < high)).all(1)
    assert found.volume_mm3 > 5000
    assert found.volume_mm3 == pytest.approx(covered.sum() * step**3 * 1e9, rel=0.015)


def test_nothing_penetrates_at_a_distance() -> None:
    far = transform(position=(0.0, 0.0, 0.3))
    found = PenetrationMeter()(OPEN, AT_ORIGIN, [block((0.05, 0.05, 0.05))], [far])
    assert (found.depth_mm, found.volume_mm3) == (0.0, 0.0)


def test_volumes_of_several_objects_add_up_and_the_depth_is_the_deepest() -> None:
    tip = middle_tip()
    wall = block((0.02, 0.02, 0.05))
    shallow, deep = (transform(position=(tip[0], tip[1], tip[2] + 0.025 - d)) for d in (0.002, 0.005))
    meter = PenetrationMeter()
    one, other = (meter(OPEN, AT_ORIGIN, [wall], [T]) for T in (shallow, deep))
    both = meter(OPEN, AT_ORIGIN, [wall, wall], [shallow, deep])
    assert both.depth_mm == other.depth_mm
    assert both.volume_mm3 == pytest.approx(one.volume_mm3 + other.volume_mm3)


def test_overlapping_parts_count_once_and_a_mesh_with_holes_falls_back_to_its_parts() -> None:
    (cube,) = shapes.box([0.04, 0.04, 0.04])
    both = from_parts("two", "cuboid", "two", [cube, cube + [0.02, 0, 0]], 0.1)
    assert solid_of(both).volume() == pytest.approx(0.06 * 0.04 * 0.04, rel=1e-5)
    whole = from_parts("one", "cuboid", "one", [cube], 0.1)
    twice = (cube.astype(np.float32), cube.astype(np.float32))
    holed = ObjectModel("holed", "cuboid", "one", 0.1, twice, whole.vertices, whole.faces[2:])
    assert solid_of(holed).volume() == pytest.approx(0.04**3, rel=1e-5)
