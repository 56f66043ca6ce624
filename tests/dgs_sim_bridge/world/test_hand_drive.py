from collections.abc import Iterator

import numpy as np
import pytest

from dgs_description.hand import HAND
from dgs_description.pick import closing_limit
from dgs_hand_driver.hand_state import HandCommand
from dgs_sim_bridge.world.physics import PHYSICS
from dgs_sim_bridge.world.world import World

FIST = np.tile([0.0, 0.8, 0.6, 0.6], 5)
ALL = np.ones(5, dtype=bool)


@pytest.fixture
def world() -> Iterator[World]:
    world = World()
    yield world
    world.close()


def run(world: World, seconds: float) -> None:
    for _ in range(round(seconds / PHYSICS.time_step)):
        world.step()


def test_position_mode_goes_at_the_commanded_speed(world: World) -> None:
    world.hand.take(HandCommand("position", FIST, 1.0, ALL, 1))
    run(world, 0.4)
    np.testing.assert_allclose(HAND.split(world.hand.state()[0])[:, 1], 0.4, atol=0.04)
    run(world, 0.6)
    np.testing.assert_allclose(world.hand.state()[0], FIST, atol=0.02)


def test_an_empty_hand_feels_on_to_its_limit_and_keeps_the_coupling(world: World) -> None:
    world.hand.take(HandCommand("admittance", FIST, 2.0, ALL, 1))
    run(world, 1.4)
    joints = HAND.split(world.hand.state()[0])
    np.testing.assert_allclose(joints[:, 1:], HAND.split(closing_limit(FIST, ALL))[:, 1:], atol=0.03)
    np.testing.assert_allclose(joints[:, 3], joints[:, 2], atol=0.02)


def test_hold_stays_where_it_is_told(world: World) -> None:
    world.hand.take(HandCommand("position", FIST, 1.0, ALL, 1))
    run(world, 0.3)
    here = world.hand.state()[0]
    world.hand.take(HandCommand("hold", here, 1.0, ALL, 2))
    run(world, 0.5)
    np.testing.assert_allclose(world.hand.state()[0], here, atol=0.02)


@pytest.mark.parametrize("mode", ["position", "admittance"])
def test_jammed_finger_stays_pushes_at_its_limit_and_comes_free(world: World, mode: str) -> None:
    world.hand.jam([False, True, False, False, False])
    world.hand.take(HandCommand(mode, FIST, 2.0, ALL, 1))  # type: ignore[arg-type]
    run(world, 1.4)
    joints, torques = world.hand.state()
    np.testing.assert_allclose(HAND.split(joints)[1], 0, atol=0.03)
    end = FIST if mode == "position" else closing_limit(FIST, ALL)
    np.testing.assert_allclose(joints[9:12], end[9:12], atol=0.03)
    np.testing.assert_allclose(torques[5:8], HAND.effort[5:8])
    world.hand.jam(np.zeros(5, dtype=bool))
    run(world, 0.05)
    if mode == "admittance":
        assert world.hand.state()[0][5:8].max() < 0.12, "it goes on from where it was, at its speed"
    run(world, 1.35)
    np.testing.assert_allclose(world.hand.state()[0][5:8], end[5:8], atol=0.03)
