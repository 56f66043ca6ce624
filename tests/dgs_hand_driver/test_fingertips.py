import numpy as np
import pytest

from dgs_hand_driver.fingertips import CONTACT_FORCE, SLIP_TIME, SlipWatch, in_contact

STEP = 0.01
THUMB = [True, False, False, False, False]


def thumb(normal: float, tangential: float) -> np.ndarray:
    forces = np.zeros((5, 2))
    forces[0] = normal, tangential
    return forces


def feel(watch: SlipWatch, pairs: np.ndarray, start: float = 0.0) -> list[bool]:
    """Whether the thumb slips, one cycle after the other."""
    told = [watch.update(start + k * STEP, thumb(*pair)) for k, pair in enumerate(pairs)]
    assert not np.any(np.array(told)[:, 1:])
    return [bool(slip[0]) for slip in told]


def test_contact_is_a_normal_force() -> None:
    assert in_contact(thumb(1.1 * CONTACT_FORCE, 0.0)).tolist() == THUMB
    assert not in_contact(thumb(0.9 * CONTACT_FORCE, 5.0)).any()
    assert not in_contact(np.full((5, 2), np.nan)).any()


def test_a_pull_that_grows_in_a_grip_that_stands_is_slip() -> None:
    still = np.tile([4.0, 0.8], (40, 1))
    pull = np.column_stack([np.full(20, 4.0), np.linspace(0.8, 3.0, 20)])
    told = feel(SlipWatch(), np.vstack([still, pull]))
    assert not any(told[:44]) and told[-1]


def test_a_grip_that_loosens_is_slip() -> None:
    loosening = np.column_stack([np.linspace(4.0, 1.0, 20), np.full(20, 0.8)])
    assert feel(SlipWatch(), np.vstack([np.tile([4.0, 0.8], (40, 1)), loosening]))[-1]


@pytest.mark.parametrize(
    "pairs",
    [
        np.column_stack([np.linspace(0.0, 4.0, 100), np.linspace(0.0, 2.0, 100)]),  # closing, at one share
        np.column_stack([np.full(100, 4.0), 0.8 + 0.2 * np.sin(np.arange(100))]),  # trembling
        np.column_stack([np.full(200, 4.0), np.linspace(0.0, 2.0, 200)]),  # lifted slowly
        np.column_stack([np.full(100, 0.1), np.linspace(0.0, 5.0, 100)]),  # hardly touched
        np.full((50, 2), np.nan),
    ],
)
def test_what_is_no_slip(pairs: np.ndarray) -> None:
    assert not any(feel(SlipWatch(), pairs))


def test_a_touch_is_no_slip_before_it_has_lasted() -> None:
    touch = np.column_stack([np.full(30, 1.0), np.linspace(0.0, 1.0, 30)])
    told = feel(SlipWatch(), np.vstack([np.zeros((50, 2)), touch]))
    assert not any(told[: 50 + round(SLIP_TIME / STEP)]) and told[-1]


def test_a_new_connection_starts_anew() -> None:
    watch = SlipWatch()
    feel(watch, np.tile([4.0, 0.4], (40, 1)), start=100.0)
    told = feel(
        watch, np.column_stack([np.full(40, 4.0), np.r_[np.full(30, 2.0), np.linspace(2.0, 4.0, 10)]])
    )
    assert not any(told[:30]) and told[-1]
