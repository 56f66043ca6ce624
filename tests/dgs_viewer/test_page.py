"""The page in a real browser, without the suite: what it shows of a state, and what its buttons ask for."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dgs_description.cell import CELL, HOME_ARM
from dgs_viewer.page import Page
from dgs_viewer.pointing import Box
from dgs_viewer.state import Cloud, Offer, ViewerState
from tests.support.browser import Tab, browser
from tests.support.grasps import top_grasps
from tests.support.live_page import PHONE, need_browser, patch, pixels, place, visit

TOP = CELL.table_height
MAGENTA = (230, 0, 230)
BLOCK = np.array([0.25, -0.15, TOP + 0.04])
"""Centre of the top of the magenta object [m]."""
BARE_TABLE = place((0.45, -0.30, TOP))


@dataclass
class Asked:
    """Writes down what the page asks for."""

    calls: list[tuple[Any, ...]] = field(default_factory=list)

    def stop(self) -> None:
        self.calls.append(("stop",))

    def reset(self) -> None:
        self.calls.append(("reset",))

    def clear(self, attempts: int, target: Box | None) -> None:
        self.calls.append(("clear", attempts, target))

    def new_scene(self, seed: int, objects: int) -> None:
        self.calls.append(("new_scene", seed, objects))


@dataclass
class Visit:
    """A page, a visitor and what the page asked for."""

    page: Page
    state: ViewerState
    asked: Asked
    tab: Tab

    def until(self, condition: Callable[[], Any], what: str) -> Any:
        """Keep the page up to date until a condition holds."""

        def look() -> Any:
            self.page.update(self.state.tick(time.time()), {"arm": 125.0})
            return condition()

        return self.tab.wait(look, what)

    def press(self, label: str) -> None:
        self.tab.press(label)

    def asks(self, label: str) -> tuple[Any, ...]:
        """Press a button; what it asked for."""
        self.asked.calls.clear()
        self.press(label)
        return self.until(lambda: self.asked.calls, f"something asked by {label!r}")[0]


def block_cloud() -> Cloud:
    """The table, and a magenta block 8 cm wide."""
    sides = np.arange(-0.04, 0.0401, 0.004)
    block = (
        np.array([(x, y, z) for x in sides for y in sides for z in np.arange(-0.03, 0.0001, 0.005)]) + BLOCK
    )
    table = np.array([(x, y, TOP) for x in np.arange(0.1, 0.5, 0.01) for y in np.arange(-0.4, 0.4, 0.01)])
    colours = np.full((len(block) + len(table), 3), 90, np.uint8)
    colours[: len(block)] = MAGENTA
    return Cloud(np.concatenate([block, table]).astype(np.float16), colours)


@contextmanager
def page_of(state: ViewerState, asked: Asked) -> Iterator[Page]:
    page = Page(state, asked, simulated=True)
    try:
        yield page
    finally:
        page.close()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Visit]:
    need_browser()
    state, asked = ViewerState(), Asked()
    with page_of(state, asked) as page, browser(tmp_path_factory.mktemp("profile")) as tab:
        state.put(cloud=block_cloud())
        page.update(state.tick(time.time()), {})
        visit(tab, "http://{}:{}/".format(*page.address))
        yield Visit(page, state, asked, tab)
    assert tab.errors == []


def test_the_cloud_is_seen_where_it_is(session: Visit):
    def magenta() -> bool:
        red, green, blue = patch(pixels(session.tab), place(BLOCK))
        return bool(min(red, blue) > green + 80)

    session.until(magenta, "the magenta block")


def test_the_robot_moves(session: Visit):
    session.state.put(arm=HOME_ARM)
    session.until(lambda: True, "")
    time.sleep(1.0)
    before = pixels(session.tab).astype(int)
    session.state.put(arm=HOME_ARM + (1.2, 0.0, 0.0, 0.0, 0.0, 0.0))
    session.until(
        lambda: (np.abs(pixels(session.tab) - before).max(axis=2) > 60).sum() > 8000, "a moved robot"
    )


@pytest.mark.parametrize(
    ("label", "call"), [("Stop", ("stop",)), ("Allow motion again", ("reset",)), ("Pick one", ("clear", 1, None)),
                        ("Clear the table", ("clear", 0, None)), ("Another scene", ("new_scene", 1, 5))]
)  # fmt: skip
def test_a_button_asks_for_what_it_says(session: Visit, label: str, call: tuple):
    assert session.asks(label) == call


def test_the_next_scene_is_another_one(session: Visit):
    first = session.asks("Another scene")[1]
    assert session.asks("Another scene")[1] == first + 1


def test_a_click_on_an_object_picks_it(session: Visit):
    session.asked.calls.clear()
    session.tab.click(*place(BLOCK))
    ((name, attempts, box),) = session.until(lambda: session.asked.calls, "a pick")
    assert (name, attempts) == ("clear", 1)
    np.testing.assert_allclose(box.centre[:2], BLOCK[:2], atol=0.01)
    np.testing.assert_allclose(box.size[:2], 0.1, atol=0.015)
    session.until(lambda: "a box of 10 x 10" in session.tab.text(), "the target's size")
    session.press("Whole table")
    session.until(lambda: "the whole table" in session.tab.text(), "no target")


def test_a_click_beside_asks_for_nothing(session: Visit):
    session.asked.calls.clear()
    session.tab.click(*place((0.25, 0.25, TOP)))
    session.asks("Stop")
    assert session.asked.calls == [("stop",)]


def test_a_drawn_box_is_the_target(session: Visit):
    (x, y), before = place(BLOCK), patch(pixels(session.tab), BARE_TABLE)
    session.press("Draw a target box")
    session.until(lambda: "Drag over the objects" in session.tab.text(), "that it waits for the drag")
    time.sleep(0.5)
    session.tab.drag((x - 90, y - 80), (x + 90, y + 90))
    session.until(lambda: "Target: a box" in session.tab.text(), "a target")
    _, attempts, box = session.asks("Clear the table")
    assert attempts == 0
    np.testing.assert_allclose(box.centre[:2], BLOCK[:2], atol=0.015)
    session.page.forget_target(None)  # a run for the whole table has ended, which began before
    assert session.asks("Clear the table")[2] is box
    np.testing.assert_allclose(
        patch(pixels(session.tab), BARE_TABLE), before, atol=30, err_msg="the view has turned"
    )
    session.press("Whole table")


def test_grasps_are_told_with_source_and_reason(session: Visit):
    grasps = top_grasps(np.repeat(BLOCK[None], 3, axis=0))
    offer = Offer(grasps, 1, {0: (205, "the thumb meets the table <at the stand-off>")})
    session.state.put(offer=offer)
    session.press("Grasps")
    wanted = ("205: the thumb meets the table <at the stand-off>", "chosen", str(grasps.source[0]))
    session.until(lambda: all(word in session.tab.text() for word in wanted), "the rows of the grasps")
    session.press("Steer")


def test_time_can_be_turned_back(session: Visit):
    session.press("Time")
    session.state.put(stage="just now")
    session.until(lambda: "just now" in session.tab.text() and "live" in session.tab.text(), "the present")
    x, y = session.tab.middle("[role=slider]")
    session.tab.drag((x, y), (x - 60, y))
    session.until(lambda: "just now" not in session.tab.text(), "the past")
    session.press("Back to live")
    session.until(lambda: "just now" in session.tab.text(), "the present again")
    session.press("Steer")


def test_a_rectangle_beside_the_objects_leaves_the_target_as_it_is() -> None:
    state, above = ViewerState(), BLOCK + (0.0, 0.0, 1.0)
    camera = SimpleNamespace(
        position=above, wxyz=(0.0, np.sqrt(0.5), -np.sqrt(0.5), 0.0), fov=1.0, aspect=1.0
    )
    with page_of(state, Asked()) as page:
        state.put(cloud=block_cloud())
        page.update(state.tick(time.time()), {})

        def drawn(low: float, high: float) -> Box | None:
            client, corners = SimpleNamespace(camera=camera), ((low, low), (high, high))
            event: Any = SimpleNamespace(client=client, screen_min=corners[0], screen_max=corners[1])
            page._on_rectangle(event)
            return page._panel.target

        box = drawn(0.4, 0.6)
        assert box is not None
        assert drawn(0.9, 0.95) is box
        assert "no object" in state.recent(1)[0].text


def test_the_way_past_the_gate_is_not_where_other_pages_look() -> None:
    with page_of(ViewerState(), Asked()) as page:
        socket.create_connection(page.address, timeout=20).close()
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", page.address[1]), timeout=20)
        with page_of(ViewerState(), Asked()) as other:
            assert other.address[0] != page.address[0]


def test_without_a_prediction_the_page_says_so() -> None:
    with page_of(ViewerState(), Asked()) as page:
        page.update(ViewerState().now, {})
        assert "no grasps predicted" in page._panel._grasps.content


def test_the_chosen_hand_is_listed_however_many_come_before_it() -> None:
    with page_of(ViewerState(), Asked()) as page:
        page._panel.show_offer(Offer(top_grasps(np.repeat(BLOCK[None], 40, axis=0)), 30))
        listed = page._panel._grasps.content
    assert "<td>31</td>" in listed and "<b>chosen</b>" in listed
    assert listed.count("<td>") == 4 * 25 and "and 15 more" in listed


def test_the_same_place_of_the_timeline_is_another_moment_later() -> None:
    state = ViewerState()
    with page_of(state, Asked()) as page:

        def shown(moment: float, now: float) -> float:
            page._panel.moment.value = moment  # type: ignore[misc]  # viser sets it by __setattr__
            page.update(state.tick(now), {})
            return page._sample.time

        assert [shown(1.0, float(t)) for t in range(100)] == list(range(100))
        assert [shown(0.5, t) for t in (100.0, 110.0)] == [50.0, 50.0]  # it stands while the run goes on
        assert [shown(1.0, float(t)) for t in range(111, 200)] == list(range(111, 200))
        assert shown(0.5, 200.0) == 100.0


def test_codes_and_sentences_are_shown(session: Visit):
    session.state.report(time.time(), "camera_node", 2, 401, "no depth image for 3.0 s: check the cable")
    session.until(
        lambda: "no depth image for 3.0 s: check the cable (401)" in session.tab.text(), "the sentence"
    )


def test_it_fits_on_a_phone(session: Visit):
    visit(session.tab, "http://{}:{}/".format(*session.page.address), PHONE)
    assert session.tab.run("document.documentElement.scrollWidth") <= PHONE[0]
    assert session.asks("Stop") == ("stop",)


def test_who_comes_alone_sees_the_present_wherever_the_last_one_left_the_timeline(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    visitor = SimpleNamespace(camera=SimpleNamespace(aspect=1.6))
    with page_of(ViewerState(), Asked()) as page:
        for others, moment in ((1, 0.3), (0, 1.0)):
            page._panel.moment.value = 0.3  # type: ignore[misc]
            visitors = dict.fromkeys(range(others + 1))
            monkeypatch.setattr(page._server, "get_clients", lambda visitors=visitors: visitors)
            page._welcome(visitor)  # type: ignore[arg-type]
            assert page._panel.moment.value == moment
