from collections.abc import Iterator

import numpy as np
import pytest

from dgs_description.cell import HOME_ARM
from dgs_description.hand import HAND
from dgs_description.joints import JointPath
from dgs_hand_driver.hand_state import HandCommand
from dgs_sim_bridge.hand.virtual_hand import VirtualHand
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.world.arm_controller import ArmGoal, Outcome
from dgs_sim_bridge.world.simulation import Pacer, Simulation
from dgs_sim_bridge.world.trajectory import FollowCode
from dgs_sim_bridge.world.world import random_scene

CATALOGUE = find_catalogue("novel")


@pytest.fixture
def simulation() -> Iterator[Simulation]:
    bus = VirtualHand(port=0)
    bus.start()
    simulation = Simulation(random_scene(CATALOGUE, 2, seed=0), bus)
    yield simulation
    simulation.close()
    bus.stop()


def run(simulation: Simulation, seconds: float) -> None:
    for _ in range(round(seconds * 240)):
        simulation.step()


def goal(outcomes: list[Outcome], offset: float = 0.3, seconds: float = 0.5) -> ArmGoal:
    ends = np.stack([HOME_ARM, HOME_ARM + offset])
    return ArmGoal(JointPath(np.array([0.0, seconds]), ends, np.zeros((2, 6))), outcomes.append)


def started(simulation: Simulation, seconds: float) -> list[Outcome]:
    """How a goal ends that is followed for so long, as far as it has."""
    outcomes: list[Outcome] = []
    simulation.start_goal(goal(outcomes))
    run(simulation, seconds)
    return outcomes


def test_goal_moves_the_simulated_arm(simulation: Simulation) -> None:
    outcomes = started(simulation, 0.7)
    assert [o.status for o in outcomes] == ["succeeded"]
    np.testing.assert_allclose(simulation.arm_state.positions, HOME_ARM + 0.3, atol=2e-3)


def test_protective_stop_pauses_the_goal_which_goes_on_afterwards(simulation: Simulation) -> None:
    outcomes = started(simulation, 0.25)
    simulation.inject("protective_stop", "", 1.0)
    run(simulation, 0.4)
    assert not outcomes and simulation.program_running
    assert (simulation.safety_mode, simulation.speed_scaling) == (3, 0)
    assert np.abs(simulation.arm_state.velocities).max() < 0.01
    run(simulation, 1.2)
    assert [o.status for o in outcomes] == ["succeeded"]
    assert (simulation.safety_mode, simulation.speed_scaling) == (1, 1)


def test_emergency_stop_ends_goal_and_program(simulation: Simulation) -> None:
    outcomes = started(simulation, 0.25)
    simulation.inject("emergency_stop", "", 1.0)
    run(simulation, 0.4)
    assert [o.status for o in outcomes] == ["aborted"] and "program" in outcomes[0].message
    assert not simulation.program_running
    assert (simulation.safety_mode, simulation.speed_scaling) == (7, 0)
    assert np.abs(simulation.arm_state.velocities).max() < 0.01
    run(simulation, 0.8)
    assert simulation.program_running and simulation.speed_scaling == 1


def test_injected_abort_hits_the_running_goal_once(simulation: Simulation) -> None:
    outcomes: list[Outcome] = []
    simulation.inject("abort_arm_goal", "", 0.0)
    run(simulation, 0.1)
    assert not outcomes
    simulation.start_goal(goal(outcomes))
    run(simulation, 0.2)
    assert [(o.status, o.code) for o in outcomes] == [("aborted", FollowCode.INVALID_GOAL)]
    positions = simulation.arm_state.positions
    simulation.start_goal(ArmGoal(JointPath(np.array([0.3]), positions[None]), outcomes.append))
    run(simulation, 0.5)
    assert outcomes[1].status == "succeeded"


def test_jam_reaches_the_hand_and_clear_ends_it(simulation: Simulation) -> None:
    simulation.inject("jam_finger", "middle", 0.0)
    run(simulation, 0.02)
    for _ in range(2):  # the hand of a new world, too
        assert simulation.world.hand._jammed.tolist() == [False, False, True, False, False]
        simulation.reset([])
        run(simulation, 0.02)
    simulation.inject("clear", "", 0.0)
    run(simulation, 0.02)
    assert not simulation.world.hand._jammed.any()


def test_reset_brings_a_new_scene_home_and_time_goes_on(simulation: Simulation) -> None:
    outcomes = started(simulation, 0.3)
    before, done = simulation.time, []
    scene = random_scene(CATALOGUE, 3, seed=9)
    simulation.reset(scene, lambda: done.append(True))
    simulation.step()
    assert done == [True] and outcomes[0].status == "aborted"
    assert before < simulation.time < before + 0.01
    assert [s.name for s in simulation.world.object_states()] == [item.model.name for item in scene]
    np.testing.assert_allclose(simulation.arm_state.positions, HOME_ARM, atol=1e-3)


def test_a_hand_that_was_closed_stays_open_after_a_reset(simulation: Simulation) -> None:
    closed = HandCommand("position", np.where(HAND.upper > 1.0, 0.6, 0.0), sequence=1)
    simulation._bus.command = lambda: closed  # type: ignore[method-assign]
    run(simulation, 1.5)
    assert simulation.world.hand.state()[0].max() > 0.4
    simulation.reset(random_scene(CATALOGUE, 1, seed=3))
    run(simulation, 1.0)
    np.testing.assert_allclose(simulation.world.hand.state()[0], 0.0, atol=0.05)


def test_after_a_reset_the_same_commands_give_the_same_world(simulation: Simulation) -> None:
    ends = []
    for _ in range(2):
        simulation.reset(random_scene(CATALOGUE, 4, seed=3))
        started(simulation, 0.8)
        ends.append(np.concatenate([s.pose.ravel() for s in simulation.world.object_states()]))
        ends[-1] = np.concatenate([ends[-1], simulation.arm_state.positions])
    np.testing.assert_array_equal(*ends)


def test_pacer_sleeps_when_ahead_and_does_not_catch_up() -> None:
    pacer = Pacer(2.0)
    assert pacer.delay(10.0) == 0.0
    assert pacer.delay(11.0) == pytest.approx(0.5, abs=0.05)
    pacer._wall -= 5.0  # as if five seconds had been lost
    assert pacer.delay(11.1) == 0.0
    assert pacer.delay(12.1) == pytest.approx(0.5, abs=0.05)
    assert Pacer(0.0).delay(100.0) == 0.0
