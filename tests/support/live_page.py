"""The live page in a browser, as a visitor uses it."""

from __future__ import annotations

import io
import re
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from dgs_description.frames import Array, look_at, to_quaternion
from dgs_viewer.page import CENTRE, EYE, FIELD_OF_VIEW
from dgs_viewer.pointing import ScreenCamera
from tests.support.browser import CHROMIUM, Tab
from tests.support.environment import GUARD

DESK, PHONE = (1440, 900), (390, 844)
"""Sizes of a window [px]."""


def need_browser() -> None:
    """Leave the calling module's tests out where there is no browser."""
    if not CHROMIUM:
        pytest.skip("no browser on this machine: apt-get install chromium", allow_module_level=True)


def printed_address(out: Path, process: subprocess.Popen) -> str:
    """The loopback address that a start script has written into `out` for people."""
    end = time.monotonic() + 2 * GUARD
    while time.monotonic() < end and process.poll() is None:
        found = re.search(r"^live page: (http://127\.0\.0\.1:\d+/)$", out.read_text(), re.MULTILINE)
        if found:
            return found[1]
        time.sleep(0.1)
    raise AssertionError(f"no live page:\n{out.read_text()}")


def place(point: ArrayLike, size: tuple[int, int] = DESK) -> tuple[float, float]:
    """Where a new visitor sees a point (3,) in `base_link` [m], in pixels."""
    position, quaternion = to_quaternion(look_at(EYE, CENTRE))
    camera = ScreenCamera(position, np.roll(quaternion, 1), FIELD_OF_VIEW, size[0] / size[1])
    (share,), (ahead,) = camera.project(np.asarray(point, np.float64)[None])
    assert ahead
    return float(share[0] * size[0]), float(share[1] * size[1])


def visit(tab: Tab, address: str, size: tuple[int, int] = DESK) -> None:
    """Open the page and wait until its picture is there, without the browser's note that it has no graphics card."""
    tab.size(*size, mobile=size is PHONE)
    tab.open(address)
    tab.wait_for_text("Allow motion again")
    tab.wait(lambda: tab.run(_CLOSE_NOTES) == 0, "the end of the notes")
    tab.wait(lambda: (pixels(tab)[: size[1] // 2].max(axis=2) > 90).mean() > 0.04, "a picture")


_CLOSE_NOTES = """(() => {
    const notes = [...document.querySelectorAll('[role=alert] button')];
    notes.forEach(button => button.click());
    return document.querySelectorAll('[role=alert]').length;
})()"""


def pixels(tab: Tab) -> NDArray[np.uint8]:
    """(H, W, 3) of the window."""
    return np.asarray(Image.open(io.BytesIO(tab.screenshot())).convert("RGB"))


def patch(picture: NDArray[np.uint8], at: tuple[float, float], radius: int = 4) -> Array:
    """(3,) mean colour around a place of a picture."""
    x, y = (round(value) for value in at)
    square = picture[y - radius : y + radius + 1, x - radius : x + radius + 1]
    return square.reshape(-1, 3).mean(axis=0)
