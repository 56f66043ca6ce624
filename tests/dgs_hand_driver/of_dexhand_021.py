"""What needs a process whose hand is the DexHand 021; `test_dexhand_021.py` runs it with DGS_HAND set."""

import threading
from collections.abc import Iterator
from contextlib import closing

import can
import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_description.frames import transform
from dgs_description.hand import HAND
from dgs_description.hand_ik import reach_with_balls
from dgs_hand_driver import dexhand_021_codec as codec
from dgs_hand_driver.bus import BusSettings
from dgs_hand_driver.dexhand_021 import LEAD, LEAD_STIFFNESS, DexHand021, DexHand021Firmware
from dgs_hand_driver.fingertips import in_contact
from dgs_hand_driver.hand import DexHand
from dgs_hand_driver.hand_settings import HandSettings
from dgs_hand_driver.hand_state import HandCommand, Mode
from dgs_hand_driver.move_goal import MoveGoal, parse_goal
from dgs_sim_bridge.render.object_model import from_parts
from dgs_sim_bridge.world.engines import open_world
from dgs_sim_bridge.world.hand_drive import HandDrive
from tests.dgs_hand_driver.simulated_hand import SimulatedHand
from tests.support.environment import wait_until
from tests.support.refused import refused

SETTINGS = HandSettings(silence_timeout=0.5, bus_timeout=0.6)
ALL = np.ones(5, dtype=bool)
SHAPE = HAND.expand(HAND.lower[HAND.driven] + 0.5 * (HAND.upper - HAND.lower)[HAND.driven])
FORCES = np.array([[1.0, 0.25], [2.0, 0.5], [0.0, 0.0], [0.0, 0.0], [0.5, 0.0]])


class Wire:
    """Both ends, with no bus between them."""

    def __init__(self) -> None:
        self.host, self.hand = DexHand021(SETTINGS), DexHand021Firmware()
        self.positions, self.torques, self.forces = np.zeros(20), np.zeros(20), np.zeros((5, 2))
        self.to_hand(self.host.greet())

    def to_hand(self, frames: list) -> None:
        for frame in frames:
            for answer in self.hand.receive(frame):
                assert self.host.receive(answer) == (answer.data[1] == 0xA4)

    def fail(self, fault: str) -> None:
        """An error of the index finger's board."""
        for frame in self.hand.inject(fault, [False, True, False, False, False]):
            self.host.receive(frame)

    def run(self, command: HandCommand, cycles: int) -> None:
        self.host.command(command)
        for _ in range(cycles):
            self.cycle()

    def cycle(self, lost: int | None = None) -> None:
        for k, frame in enumerate(self.hand.state(self.positions, self.torques, self.forces, 0.0)):
            assert k == lost or self.host.receive(frame)
        self.to_hand(self.host.follow_up())
        if self.hand.command.sequence:
            self.positions = self.hand.command.target


@pytest.fixture
def wire() -> Wire:
    """That has told a first state."""
    wire = Wire()
    wire.cycle()
    return wire


def test_the_boards_are_silent_until_they_are_told_to_report() -> None:
    assert DexHand021Firmware().state(np.zeros(20), np.zeros(20), np.zeros((5, 2)), 0.0) == []


def test_positions_torques_and_forces_arrive() -> None:
    wire = Wire()
    wire.positions, wire.torques, wire.forces = SHAPE, np.linspace(-0.5, 0.5, 20), FORCES
    wire.cycle()
    state = wire.host.state
    assert state is not None and np.abs(state.positions - SHAPE).max() <= np.radians(0.0051)
    assert np.array_equal(state.forces, FORCES)
    pair = wire.torques[2] + wire.torques[3]
    assert state.torques[:4] == pytest.approx([wire.torques[0], wire.torques[1], pair, 0.0], abs=6e-4)
    index, ring, little = (
        wire.torques[HAND.joints.index(f"{f}_joint1")] for f in ("index", "ring", "little")
    )
    assert state.torques[4] == pytest.approx(index - ring - little, abs=6e-4)
    assert not state.torques[8] and not state.torques[12]  # locked; spread by the index finger's motor


def test_joints_go_at_the_speed_of_the_command_which_is_acknowledged(wire: Wire) -> None:
    wire.run(HandCommand("position", SHAPE, 0.5, ALL, 7), 21)
    assert wire.host.state.accepted == 7
    assert np.abs(wire.positions[[1, 5]] - 0.1).max() < 0.006  # 0.2 s
    wire.run(HandCommand("position", SHAPE, 0.5, ALL, 7), 400)
    assert np.abs(wire.host.state.positions - SHAPE).max() < 2e-4


def test_what_a_finger_meets_it_yields_to(wire: Wire) -> None:
    wall = np.full(20, np.inf)
    wall[5] = 0.4
    wire.host.command(HandCommand("admittance", SHAPE, 1.0, ALL, 1))
    for _ in range(300):
        wire.torques = 10.0 * np.maximum(wire.positions - wall, 0.0)
        wire.cycle()
    assert 0.1 < wire.torques[5] < 1.05 * HAND.effort[5] and wire.positions[1] > 0.6
    still = wire.positions[5]
    wire.cycle()
    assert wire.positions[5] == pytest.approx(still, abs=1e-3)


@pytest.mark.parametrize("mode", ["position", "admittance"])
def test_cycles_that_waited_do_not_become_a_jump(wire: Wire, mode: Mode) -> None:
    wire.run(HandCommand(mode, SHAPE, 1.0, ALL, 1), 2)
    stood = wire.positions
    assert np.abs(SHAPE - stood)[HAND.driven].min() > 0.25
    for _ in range(40):
        wire.cycle()
        wire.positions = stood
    after = wire.hand.command.target
    assert np.abs(after - stood).max() < LEAD + 2e-4
    wire.positions = after
    wire.cycle()
    assert np.abs(wire.positions - after).max() < 0.0102
    for _ in range(300):
        wire.cycle()
    assert (HAND.flexes.reshape(-1) * (SHAPE - wire.positions)).max() < 2e-4


def test_a_soft_motor_may_push_as_hard_as_it_can(wire: Wire) -> None:
    wire.host.command(HandCommand("position", SHAPE, 1.0, ALL, 1))
    for _ in range(300):
        wire.torques = (LEAD_STIFFNESS + 1.0) * np.maximum(wire.positions - 0.1, 0.0)
        wire.positions = np.minimum(wire.positions, 0.1)
        wire.cycle()
    assert np.abs(wire.positions - SHAPE).max() < 2e-4


@pytest.mark.parametrize("lost", range(1, 6))
def test_cycle_with_a_lost_report_is_dropped_and_its_time_counted(wire: Wire, lost: int) -> None:
    wire.cycle(lost)
    wire.cycle()
    wire.cycle()
    state = wire.host.state
    assert wire.host.incomplete == 1 and state.cycle == 3
    assert state.clock == pytest.approx(0.04)


def test_the_first_board_of_the_next_cycle_completes_one_without_it(wire: Wire) -> None:
    wire.cycle(0)
    assert wire.host.state.cycle == 1
    wire.cycle()
    assert wire.host.state.cycle == 2


def test_a_fingertip_without_readings_is_no_contact() -> None:
    wire = Wire()
    frames = wire.hand.state(np.zeros(20), np.zeros(20), FORCES, 0.0)
    frames[0].data = frames[0].data[:16]
    for frame in frames:
        wire.host.receive(frame)
    forces = wire.host.state.forces
    assert np.isnan(forces[0]).all() and np.array_equal(forces[1:], FORCES[1:])
    for frame in frames:
        frame.data = frame.data[:16]
        wire.host.receive(frame)
    assert wire.host.state.forces is None


@pytest.mark.parametrize(
    ("fault", "code"), [("joint_sensor", ErrorCode.HAND_INTERNAL), ("stall", ErrorCode.HAND_BLOCKED)]
)
def test_an_error_stops_a_finger_until_it_is_cleared(wire: Wire, fault: str, code: ErrorCode) -> None:
    wire.run(HandCommand("position", SHAPE, 0.5, ALL, 1), 10)
    wire.fail(fault)
    told = wire.host.fault
    assert told is not None and told.code == code
    assert told.message == f"the hand reports {fault} of index_joint3, index_joint2; the next goal clears it"
    before = wire.positions.copy()
    wire.run(HandCommand("position", SHAPE, 0.5, ALL, 1), 10)
    assert wire.positions[5] == before[5] and wire.positions[9] > before[9]
    wire.to_hand(wire.host.clear_fault())
    assert wire.host.fault is None and wire.host.clear_fault() == []
    wire.run(HandCommand("position", SHAPE, 0.5, ALL, 1), 10)
    assert wire.positions[5] > before[5]


def test_a_stall_on_what_is_held_is_cleared_on_the_way(wire: Wire) -> None:
    wire.run(HandCommand("admittance", SHAPE, 0.5, ALL, 1), 10)
    wire.fail("stall")
    assert wire.host.fault is None
    before = wire.positions.copy()
    wire.run(HandCommand("admittance", SHAPE, 0.5, ALL, 1), 10)
    assert wire.positions[5] > before[5]


def test_a_stall_on_what_is_held_is_none_of_the_opening_that_follows_at_once(wire: Wire) -> None:
    wire.run(HandCommand("admittance", SHAPE, 0.5, ALL, 1), 10)
    assert wire.host.clear_fault() == []
    wire.host.command(HandCommand("position", np.zeros(20), 0.5, ALL, 2))
    wire.fail("stall")
    wire.cycle()
    assert wire.host.fault is None
    before = wire.positions.copy()
    wire.cycle()
    assert wire.positions[5] < before[5]


def test_unknown_fault_is_refused() -> None:
    with pytest.raises(ValueError, match="stall"):
        DexHand021Firmware().inject("tired", ALL)


def test_foreign_frames_are_ignored() -> None:
    host = DexHand021(SETTINGS)
    assert not any(host.receive(frame) for frame in codec.encode_motion(np.zeros(12)))
    assert host.state is None


def test_what_is_grasped_over_the_wire_is_held_whichever_way_gravity_points() -> None:
    balls = np.zeros((5, 3))
    balls[:, 2], balls[1:, 1] = 0.02, HAND.base_poses[1:, 1, 3]
    balls[0, 0], balls[1:, 0] = 0.05 + HAND.ball_radius, 0.01 - HAND.ball_radius
    balls[0, 1] = balls[1:4, 1].mean()
    joints = HAND.settled(reach_with_balls(HAND, balls).reshape(-1))
    active = np.array([True, True, True, True, False])
    start = HAND.settled(HAND.pre_grasp(joints, active))
    block = from_parts(
        "block", "cuboid", "block", [np.array(list(np.ndindex(2, 2, 2))) * (0.04, 0.12, 0.06)], 0.2
    )
    place = transform(position=(0.03, balls[0, 1], 0.02))
    with open_world("pybullet", [block], [place], False) as world:
        world.put_hand(np.eye(4), start)
        drive, wire = HandDrive(world._motors, start), Wire()

        def run_for(seconds: float) -> None:
            for now in np.arange(0.0, seconds, world.period):
                if now % 0.01 < world.period:
                    (wire.positions, wire.torques), wire.forces = drive.state(), drive.fingertip_forces()
                    wire.cycle()
                    if wire.hand.command.sequence:
                        drive.take(wire.hand.command)
                drive.step(world.period)
                world._advance()

        world.set_gravity(np.zeros(3))
        run_for(0.1)
        wire.host.command(HandCommand("admittance", joints, 1.0, active, 1))
        run_for(2.5)
        held = world.object_pose(0)[:3, 3]
        assert in_contact(wire.host.state.forces)[active].all()
        for gravity in 9.81 * np.vstack([np.eye(3), -np.eye(3)]):
            world.set_gravity(gravity)
            run_for(0.5)
            assert np.linalg.norm(world.object_pose(0)[:3, 3] - held) < 0.01


# Over the bus.


@pytest.fixture
def simulated() -> Iterator[SimulatedHand]:
    with SimulatedHand(time_step=0.01, stiffness=10.0) as simulated:
        yield simulated


@pytest.fixture
def hand(simulated: SimulatedHand) -> Iterator[DexHand]:
    with closing(DexHand(BusSettings(port=simulated.port), SETTINGS)) as hand:
        wait_until(lambda: hand.lost is None)
        yield hand


def test_a_board_that_starts_late_is_named_and_greeted_again(simulated: SimulatedHand, monkeypatch) -> None:
    monkeypatch.setattr("dgs_hand_driver.hand._GREET_PERIOD", 0.1)
    receive, greetings, started = simulated.bus_end._firmware.receive, [], threading.Event()

    def receive_late(message: can.Message) -> list[can.Message]:
        if message.arbitration_id != 0x00A:
            return receive(message)
        greetings.append(message)
        return receive(message) if started.is_set() else []

    monkeypatch.setattr(simulated.bus_end._firmware, "receive", receive_late)
    with closing(DexHand(BusSettings(port=simulated.port), SETTINGS)) as hand:
        wait_until(lambda: len(greetings) > 1 and hand._protocol.absent)
        with refused(ErrorCode.HAND_SILENT, "nothing is heard from board 10 of middle_joint3, middle_joint2"):
            hand.state()
        started.set()
        wait_until(lambda: hand._protocol.state is not None)
        assert hand.move(goal(SHAPE)).code == ErrorCode.SUCCESS


def goal(positions: np.ndarray, mode: int = 0, speed: float = 1.5) -> MoveGoal:
    return parse_goal(HAND.joints, positions, speed, mode)


def test_goes_to_positions_and_grasps(simulated: SimulatedHand, hand: DexHand) -> None:
    outcome = hand.move(goal(SHAPE))
    assert outcome.code == ErrorCode.SUCCESS and np.abs(simulated.positions - SHAPE).max() < 0.03
    closed = np.minimum(SHAPE + HAND.flexes.reshape(-1) * 0.2, HAND.upper)
    simulated.walls = {"thumb_joint2": SHAPE[1] + 0.1, "index_joint2": SHAPE[5] + 0.1}
    outcome = hand.move(goal(closed, mode=1))
    assert outcome.code == ErrorCode.SUCCESS and outcome.fingers_in_contact == ("thumb", "index")


def test_what_only_the_fingertip_feels_is_contact(simulated: SimulatedHand, hand: DexHand) -> None:
    simulated.forces = np.zeros((5, 2))
    simulated.forces[2] = [1.0, 0.2]
    outcome = hand.move(goal(SHAPE * 0.5, mode=1))
    assert outcome.fingers_in_contact == ("middle",)


def test_contact_on_the_way_stops_the_whole_hand(simulated: SimulatedHand, hand: DexHand) -> None:
    simulated.walls = {"index_joint2": 0.2}
    simulated.stiffness = np.inf
    outcome = hand.move(goal(SHAPE))
    assert outcome.code == ErrorCode.HAND_BLOCKED and outcome.fingers_in_contact == ("index",)


def test_an_error_ends_the_move_and_the_next_one_clears_it(simulated: SimulatedHand, hand: DexHand) -> None:
    def fail(_: object, progress: float) -> None:
        if 0.3 < progress < 0.6:
            simulated.bus_end.inject("over_current", [True, False, False, False, False])

    with refused(ErrorCode.HAND_INTERNAL, r"over_current of thumb_joint3, thumb_joint2"):
        hand.move(goal(SHAPE), on_progress=fail)
    assert hand.fault is not None
    assert hand.move(goal(SHAPE)).code == ErrorCode.SUCCESS
    assert hand.fault is None
