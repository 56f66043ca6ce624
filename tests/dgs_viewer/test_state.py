"""What the page remembers."""

from __future__ import annotations

import numpy as np

from dgs_viewer.state import KEPT_EVERY, SAMPLES, SILENT, Cloud, RateMeter, ViewerState

WARN = 1


def cloud() -> Cloud:
    return Cloud(np.zeros((1, 3), np.float16), np.zeros((1, 3), np.uint8))


def test_the_timeline_gives_back_what_was():
    state = ViewerState()
    for k in range(5):
        state.put(stage=f"stage {k}", arm=np.full(6, float(k)))
        state.tick(10.0 + k)
    assert state.span() == (10.0, 14.0)
    assert state.at(12.0).stage == "stage 2"
    np.testing.assert_array_equal(state.at(12.4).arm, np.full(6, 3.0))
    assert state.at(99.0) is state.now


def test_a_page_without_a_past_shows_the_present():
    state = ViewerState()
    assert state.span() == (0.0, 0.0)
    assert state.at(0.0) is state.now


def test_memory_is_bounded():
    state = ViewerState()
    clouds = set()
    for k in range(SAMPLES + 50):
        if k % 5 == 0:
            state.put(cloud=cloud())
        state.tick(0.1 * k)
        clouds.add(id(state.at(0.1 * k).cloud))
    first, last = state.span()
    assert np.isclose(last - first, 0.1 * (SAMPLES - 1))
    assert len(clouds) <= 0.1 * (SAMPLES + 50) / KEPT_EVERY + 2


def test_the_newest_cloud_is_shown_at_once_whatever_is_remembered():
    state = ViewerState()
    state.put(cloud=cloud())
    state.tick(0.0)
    newest = cloud()
    state.put(cloud=newest)
    assert state.tick(0.1).cloud is newest
    assert state.at(0.1).cloud is not newest


def test_news_is_logged_once():
    state = ViewerState()
    state.report(1.0, "arm", 0, 0, "idle")
    assert state.recent(5) == []
    for time in (2.0, 3.0):
        state.report(time, "arm", WARN, 211, "stopped; call /reset to allow motion")
    (event,) = state.recent(5)
    assert (event.time, event.level, event.code) == (2.0, WARN, 211)
    assert [(trouble.code, trouble.text[:4]) for trouble in state.troubles()] == [(211, "arm:")]
    state.report(4.0, "arm", 0, 0, "idle")
    assert state.troubles() == []
    state.report(5.0, "camera", WARN, 0, "inactive")
    assert state.troubles()
    state.tick(5.0 + 2 * SILENT)
    assert state.troubles() == [], "who says nothing any more says nothing of now"


def test_the_log_shows_the_newest_first():
    state = ViewerState()
    for k in range(4):
        state.log(float(k), f"line {k}")
    assert [event.text for event in state.recent(2)] == ["line 3", "line 2"]


def test_rates_follow_what_comes():
    meter = RateMeter()
    meter.update(100.0)
    for _ in range(20):
        meter.count("arm")
    meter.update(101.0)
    assert "arm" not in meter.rates, "too early"
    meter.update(104.0)
    assert meter.rates["arm"] == 5.0
    meter.update(106.0)
    assert meter.rates["arm"] == 0.0
