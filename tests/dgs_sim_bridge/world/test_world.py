from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dgs_description.arm_model import forward_kinematics
from dgs_description.cell import CELL, HOME_ARM
from dgs_description.frames import inverse, transform
from dgs_description.hand import HAND
from dgs_description.hand_ik import inverse_kinematics
from dgs_description.joints import ARM_EFFORT
from dgs_hand_driver.hand_state import HandCommand
from dgs_sim_bridge.render.object_model import find_catalogue, from_parts
from dgs_sim_bridge.world.physics import PHYSICS
from dgs_sim_bridge.world.scenes import PlacedObject
from dgs_sim_bridge.world.world import World, random_scene
from tests.support.hands import in_process_of

CATALOGUE = find_catalogue("novel")
T_TOOL_TCP = HAND.T_mount_tcp
POINTING_DOWN = np.diag([1.0, -1.0, -1.0])
RADIUS = 0.03
HEIGHT = CELL.table_height


def can(x: float, y: float, bottom: float) -> PlacedObject:
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = [(RADIUS * np.cos(a), RADIUS * np.sin(a), z) for a in angles for z in (-0.06, 0.06)]
    model = from_parts("can", "cylinder", "can", [np.array(rim)], 0.25)
    return PlacedObject(model, transform(position=(x, y, bottom + 0.06)))


def arm_joints(T_base_tcp: np.ndarray, start: np.ndarray) -> np.ndarray:
    def error(q: np.ndarray) -> np.ndarray:
        T = inverse(T_base_tcp) @ forward_kinematics(q) @ T_TOOL_TCP
        return np.r_[5 * T[:3, 3], Rotation.from_matrix(T[:3, :3]).as_rotvec()]

    solution = least_squares(error, start)
    assert solution.cost < 1e-12
    return solution.x


@pytest.fixture
def opened() -> Iterator[Callable[..., World]]:
    """Makes worlds as `World` does, which are closed afterwards."""
    with ExitStack() as stack:
        yield lambda *args, **options: stack.enter_context(closing(World(*args, **options)))


def run(world: World, seconds: float) -> None:
    for _ in range(round(seconds / PHYSICS.time_step)):
        world.step()


def test_links_are_where_the_kinematic_models_say(opened: Callable[..., World]) -> None:
    rng = np.random.default_rng(0)
    arm, hand = HOME_ARM + rng.uniform(-0.3, 0.3, 6), rng.uniform(0, 0.9, 20)
    HAND.split(hand)[:, 0] -= 0.45
    HAND.split(hand)[:, 0] *= 0.5
    world = opened(arm_joints=arm, hand_joints=hand)
    T_base_tcp = forward_kinematics(arm) @ T_TOOL_TCP
    np.testing.assert_allclose(world.link_pose("hand_tcp"), T_base_tcp, atol=1e-5)
    frames = HAND.link_frames(hand)
    np.testing.assert_allclose(world.link_pose("thumb_distal"), T_base_tcp @ frames[0, 3], atol=1e-5)
    np.testing.assert_allclose(world.link_pose("ring_middle"), T_base_tcp @ frames[3, 2], atol=1e-5)


def test_a_hand_that_cannot_be_straight_starts_within_its_limits() -> None:
    code = """
from dgs_description.hand import HAND
from dgs_sim_bridge.world.world import World
world = World()
world.step()
joints, torques = world.hand.state()
print(abs(joints - HAND.straight).max() < 0.01 and (abs(torques) < HAND.effort / 2).all())
"""
    assert in_process_of("allegro", code).split()[-1] == "True"


def test_arm_holds_and_follows_within_its_torques(opened: Callable[..., World]) -> None:
    world = opened()
    torque = np.zeros(6)
    amplitude, duration = np.array([0.8, 0.3, -0.4, 0.5, 0.3, 1.0]), 1.0
    for k in range(240):
        s = min(k / 240 / duration, 1.0)
        position = HOME_ARM + amplitude * (10 * s**3 - 15 * s**4 + 6 * s**5)
        velocity = amplitude * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
        world.arm.command(position, velocity)
        world.step()
        state = world.arm_state()
        torque = np.maximum(torque, np.abs(state.efforts))
        assert np.abs(state.positions - position).max() < 0.01
    assert (torque <= ARM_EFFORT * 1.001).all()
    run(world, 0.3)
    np.testing.assert_allclose(world.arm_state().positions, HOME_ARM + amplitude, atol=1e-3)


def test_scene_stays_as_it_was_dropped(opened: Callable[..., World]) -> None:
    placed = random_scene(CATALOGUE, 6, seed=2)
    world = opened(placed)
    run(world, 1.0)
    states = world.object_states()
    assert [s.name for s in states] == [item.model.name for item in placed]
    assert {s.place for s in states} == {"table"}
    for state, item in zip(states, placed, strict=True):
        np.testing.assert_allclose(state.pose[:3, 3], item.pose[:3, 3], atol=0.003)


def test_places_of_objects(opened: Callable[..., World]) -> None:
    x, y = CELL.bin_centre
    beside = (CELL.table_centre[0] + CELL.table_size[0] / 2 + 0.3, -0.3)
    world = opened(
        [
            can(0.3, 0.1, HEIGHT),
            can(x, y, HEIGHT + 0.02),
            can(*beside, HEIGHT - 0.03),
            can(0.3, -0.2, HEIGHT + 0.14),
        ]
    )
    for _ in range(2):  # in the air is not held, and then it lies there
        assert [s.place for s in world.object_states()] == ["table", "bin", "floor", "table"]
        run(world, 0.5)


def test_what_lies_on_a_heap_above_the_rim_is_in_the_bin_and_what_flies_over_it_is_not(
    opened: Callable[..., World],
) -> None:
    x, y = CELL.bin_centre
    floor = HEIGHT + CELL.bin_wall
    world = opened(
        [can(x, y, floor), can(x, y, floor + 0.12), can(x, y, floor + 0.241), can(x + 0.1, y, HEIGHT + 0.35)]
    )
    run(world, 0.05)
    assert world.object_states()[2].pose[2, 3] - 0.06 > HEIGHT + CELL.bin_size[2]
    assert [s.place for s in world.object_states()] == ["bin", "bin", "bin", "table"]


def pick(world: World, arm: np.ndarray, lifted: np.ndarray, closing: np.ndarray) -> float:
    """Close the hand and lift 0.15 m in one second each; returns the highest share of a torque limit that was used."""
    world.hand.take(HandCommand("admittance", closing, 2.0, np.ones(5, dtype=bool), 1))
    used = 0.0
    for k in range(600):
        s = np.clip((k - 240) / 240, 0, 1)
        world.arm.command(arm + (lifted - arm) * (10 * s**3 - 15 * s**4 + 6 * s**5), np.zeros(6))
        world.step()
        used = max(used, float(np.max(np.abs(world.hand.state()[1]) / HAND.effort)))
    return used


def test_hand_lifts_a_can_by_contact_alone_and_the_run_is_repeatable(opened: Callable[..., World]) -> None:
    T_base_tcp = transform(POINTING_DOWN, (0.33, 0.0, HEIGHT + 0.10))
    arm = arm_joints(T_base_tcp, HOME_ARM + (1.7, 0, 0, 0, 0, 0))
    lifted = arm_joints(transform(position=(0, 0, 0.15)) @ T_base_tcp, arm)
    middle = np.array([0.008, 0.0, 0.035])
    long_fingers = [middle + (-0.8 * RADIUS, y, 0) for y in (0.030, 0.008, -0.015, -0.035)]
    joints = inverse_kinematics(HAND, np.array([middle + (0.85 * RADIUS, 0.5 * RADIUS, 0), *long_fingers]))
    centre = (T_base_tcp @ [*middle, 1.0])[:2]
    ends = []
    for _ in range(2):
        world = opened([can(*centre, HEIGHT)], arm_joints=arm, hand_joints=HAND.pre_grasp(joints).ravel())
        used = pick(world, arm, lifted, joints.ravel())
        (state,) = world.object_states()
        assert state.place == "held"
        assert 0.13 < state.pose[2, 3] - (HEIGHT + 0.06) < 0.19
        assert used <= 1.001
        normal, tangential = world.hand.fingertip_forces().T
        assert normal[0] > 1.0 and (normal[1:] > 0.3).any()
        # The fingertips hold it from its sides: they bear its weight along their surfaces.
        assert (tangential <= PHYSICS.hand_friction * normal + 1e-6).all()
        assert tangential.sum() > 0.5 * 0.25 * PHYSICS.gravity
        ends.append((state.pose, world.hand.state()[0], world.arm_state().positions))
    for one, two in zip(*ends, strict=True):
        np.testing.assert_array_equal(one, two)
    run(world, 0.3)
    felt = world.link_pose("tool0")[:3, :3] @ world.wrench()[:3]
    np.testing.assert_allclose(felt, (0, 0, -0.25 * PHYSICS.gravity), atol=0.05)  # nothing but the weight
    # Without the hand's grip it falls: nothing else holds it.
    world.hand.take(HandCommand("position", np.zeros(20), 3.0, np.ones(5, dtype=bool), 2))
    run(world, 1.5)
    assert world.object_states()[0].place == "table"
    assert not world.hand.fingertip_forces().any()


def test_closing_twice_is_harmless() -> None:
    world = World()
    world.close()
    world.close()
