import numpy as np
import pytest

from dgs_hand_driver.can_protocol import CLOCK_RANGE, HandProtocol
from dgs_hand_driver.hand_state import HandState, StateAssembler

PROTOCOL = HandProtocol()


def feed(assembler: StateAssembler, clock: float, sequence: int, lost: int | None = None) -> HandState | None:
    frames = PROTOCOL.encode_state(np.full(20, 0.2), np.zeros(20), "position", 0, clock, sequence)
    states = [assembler.add(PROTOCOL.decode(f)) for k, f in enumerate(frames) if k != lost]
    return states[-1]


@pytest.mark.parametrize("lost", range(10))
def test_cycle_with_a_lost_frame_is_dropped_and_counted(lost: int) -> None:
    assembler = StateAssembler()
    assert feed(assembler, 0.0, 1) is not None
    assert feed(assembler, 0.1, 2, lost) is None
    assert assembler.incomplete == 1
    assert feed(assembler, 0.2, 3) is not None


def test_clock_starts_at_zero_and_never_goes_back() -> None:
    assembler = StateAssembler()
    clocks = [100.0, 100.5, 3.0, 3.25, CLOCK_RANGE - 0.25, 0.25, 0.5]
    times = [feed(assembler, clock, k).clock for k, clock in enumerate(clocks)]
    # Restarted after 100.5, set forward after 3.25: nothing counts; wrapped after CLOCK_RANGE: 0.5 s.
    assert times == pytest.approx([0.0, 0.5, 0.5, 0.75, 0.75, 1.25, 1.5], abs=2e-3)
