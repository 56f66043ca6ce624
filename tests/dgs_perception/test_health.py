"""What the camera node says about itself."""

from __future__ import annotations

import pytest

from dgs_description.errors import DgsError, ErrorCode
from dgs_perception.health import CameraHealth, HealthReport
from dgs_perception.workspace import CropCounts

COUNTS = CropCounts(received=10, not_finite=1, zero=2, outside=3, kept=4)
BAD = DgsError(ErrorCode.DEPTH_FORMAT, "The encoding is wrong.")


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def health(clock: Clock) -> CameraHealth:
    return CameraHealth("/depth", 2.0, clock)


def assert_well(report: HealthReport, sentence: str) -> None:
    assert (report.code, report.degraded, report.sentence) == (ErrorCode.SUCCESS, False, sentence)


def test_a_new_camera_is_waited_for_then_silent(health, clock):
    report = health.report()
    assert_well(report, "Waiting for the first input from /depth.")
    assert "age_s" not in report.values
    clock.now += 2.5
    report = health.report()
    assert report.code == ErrorCode.CAMERA_SILENT == 401 and report.degraded
    assert report.sentence == "No input from /depth for 2.5 s; is it running and connected?"
    assert report.values["code"] == 401


def test_figures_of_a_camera_at_work(health, clock):
    for _ in range(41):
        clock.now += 0.1
        health.cloud(COUNTS, seconds=0.0061, age=0.05)
    clock.now += 0.1
    report = health.report()
    assert_well(report, "Clouds come from /depth.")
    assert report.values["rate_hz"] == pytest.approx(29 / 3.0, abs=0.01)
    assert report.values["age_s"] == pytest.approx(0.15)
    assert report.values["processing_ms"] == 6.1
    assert report.values["clouds"] == 41 and report.values["skipped"] == 0
    assert [report.values[f"points_{name}"] for name in ("received", "zero", "kept")] == [10, 2, 4]


def test_silence_after_clouds_and_a_falling_rate(health, clock):
    for _ in range(5):
        clock.now += 0.1
        health.cloud(COUNTS, 0.006, 0.05)
    clock.now += 10.0
    report = health.report()
    assert report.code == ErrorCode.CAMERA_SILENT
    assert report.values["rate_hz"] < 0.5 and report.values["age_s"] == pytest.approx(10.05)


def test_bad_input_between_good_is_a_warning_once(health, clock):
    health.cloud(COUNTS, 0.006, 0.05)
    assert health.skipped(BAD)
    assert not health.skipped(BAD)
    report = health.report()
    assert (report.code, report.degraded) == (ErrorCode.SUCCESS, True)
    assert report.sentence == "Input was skipped: The encoding is wrong." and report.values["skipped"] == 2
    assert not health.report().degraded
    assert health.skipped(BAD)  # after it worked again it is news


@pytest.mark.parametrize(("timeout", "pause"), [(2.0, 1.0), (1.0, 2.5), (10.0, 8.0)])
def test_only_bad_input_is_an_error_with_its_code_while_it_comes(clock, timeout, pause):
    health = CameraHealth("/depth", timeout, clock)
    for _ in range(10):
        health.skipped(BAD)
        clock.now += pause
        assert health.report().code == ErrorCode.DEPTH_FORMAT
    clock.now += 6.0
    assert health.report().code == ErrorCode.CAMERA_SILENT


def test_a_bag_that_is_over_is_not_silent(health, clock):
    health.cloud(COUNTS, 0.006, 0.05)
    health.idle("The bag has been replayed.")
    for pause in (1.0, 60.0):
        clock.now += pause
        assert_well(health.report(), "The bag has been replayed.")


def test_a_source_that_begins_after_a_wait_is_given_its_time(health, clock):
    health.idle("The bag waits.")
    clock.now += 60.0
    assert health.report().sentence == "The bag waits."
    health.idle("")
    clock.now += 1.0
    assert health.report().sentence.startswith("Waiting for the first input")
    clock.now += 1.5
    assert health.report().code == ErrorCode.CAMERA_SILENT


def test_silence_counts_from_where_the_camera_goes_on(health, clock):
    health.cloud(COUNTS, 0.01, 0.1)
    clock.now += 60.0
    health.resumed()
    assert health.report().code == ErrorCode.SUCCESS
    clock.now += 2.5
    assert health.report().code == ErrorCode.CAMERA_SILENT
