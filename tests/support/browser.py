"""A real headless Chromium, driven over its DevTools protocol."""

from __future__ import annotations

import base64
import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import connect
from websockets.sync.connection import Connection

from tests.support.environment import GUARD

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), ""
)
"""The browser's executable; "" where there is none."""
_OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
)


class Tab:
    """The one tab of a browser. Places on the page are in pixels."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._count = 0
        self.errors: list[str] = []
        """Exceptions of the page's own scripts."""
        self._call("Page.enable")
        self._call("Runtime.enable")

    def size(self, width: int, height: int, mobile: bool = False) -> None:
        """Of the window [px]."""
        self._call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=mobile,
        )

    def open(self, address: str) -> None:
        """Load a page."""
        self._call("Page.navigate", url=address)

    def run(self, script: str) -> Any:
        """Value of a JavaScript expression. Raises RuntimeError with the script's own words."""
        answer = self._call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(json.dumps(answer["exceptionDetails"])[:500])
        return answer["result"].get("value")

    def text(self) -> str:
        """What a reader sees of the page."""
        return str(self.run("document.body ? document.body.innerText : ''"))

    def wait(self, condition: Callable[[], Any], what: str, timeout: float = GUARD) -> Any:
        """The first true value of a condition. Raises TimeoutError that names `what` and shows the page's text."""
        end = time.monotonic() + timeout
        while True:
            value = condition()
            if value:
                return value
            if time.monotonic() > end:
                raise TimeoutError(f"not within {timeout:g} s: {what}; the page says:\n{self.text()}")
            time.sleep(0.1)

    def wait_for_text(self, wanted: str, timeout: float = GUARD) -> None:
        """Wait until the page shows a text."""
        self.wait(lambda: wanted in self.text(), f"text {wanted!r}", timeout)

    def press(self, label: str) -> None:
        """Click the button or tab with exactly this label."""
        self.click(*self.place(label))

    def place(self, label: str) -> tuple[float, float]:
        """Middle of the button or tab with exactly this label, which is brought into view."""
        find = f"""(() => {{
            const all = [...document.querySelectorAll('button, [role=tab]')];
            const found = all.find(e => e.innerText.trim() === {json.dumps(label)});
            if (!found) return null;
            found.scrollIntoView({{block: 'center'}});
            const r = found.getBoundingClientRect();
            return [r.x + r.width / 2, r.y + r.height / 2];
        }})()"""
        x, y = self.wait(lambda: self.run(find), f"button {label!r}")
        return x, y

    def middle(self, selector: str) -> tuple[float, float]:
        """Of the first visible element of a CSS selector."""
        find = f"""(() => {{
            const found = [...document.querySelectorAll({json.dumps(selector)})].find(e => e.checkVisibility());
            if (!found) return null;
            const r = found.getBoundingClientRect();
            return [r.x + r.width / 2, r.y + r.height / 2];
        }})()"""
        x, y = self.wait(lambda: self.run(find), f"an element {selector!r}")
        return x, y

    def click(self, x: float, y: float) -> None:
        """Press and let go of the left button."""
        self._mouse("mouseMoved", x, y)
        self._mouse("mousePressed", x, y)
        time.sleep(0.05)
        self._mouse("mouseReleased", x, y)

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 8) -> None:
        """Move with the left button down."""
        self._mouse("mouseMoved", *start)
        self._mouse("mousePressed", *start)
        for k in range(1, steps + 1):
            share = k / steps
            self._mouse("mouseMoved", *((1 - share) * a + share * b for a, b in zip(start, end, strict=True)))
            time.sleep(0.03)
        self._mouse("mouseReleased", *end)

    def screenshot(self) -> bytes:
        """The window as PNG."""
        return base64.b64decode(self._call("Page.captureScreenshot", format="png")["data"])

    def _mouse(self, kind: str, x: float, y: float) -> None:
        down = kind != "mouseMoved"
        self._call(
            "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left" if down else "none", clickCount=int(down),
            buttons=int(kind == "mousePressed"), pointerType="mouse",
        )  # fmt: skip

    def _call(self, method: str, **parameters: Any) -> Any:
        self._count += 1
        self._connection.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._connection.recv(timeout=GUARD))
            if message.get("method") == "Runtime.exceptionThrown":
                self.errors.append(json.dumps(message["params"])[:500])
            if message.get("id") == self._count:
                if "error" in message:
                    raise RuntimeError(f"{method}: {message['error']}")
                return message["result"]


@contextmanager
def browser(folder: Path) -> Iterator[Tab]:
    """A fresh browser with one empty tab; its profile lies in `folder`, which must be empty."""
    command = [CHROMIUM, *_OPTIONS, f"--user-data-dir={folder}", "about:blank"]
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        with connect(_tab_address(folder, process), max_size=None, compression=None) as connection:
            yield Tab(connection)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def _tab_address(folder: Path, process: subprocess.Popen) -> str:
    """Websocket address of the first tab."""
    import urllib.request

    announced, end = folder / "DevToolsActivePort", time.monotonic() + GUARD
    while time.monotonic() < end and process.poll() is None:
        if announced.is_file() and announced.read_text().count("\n"):
            port = announced.read_text().splitlines()[0]
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json/list", timeout=GUARD) as answer:
                tabs = [each for each in json.load(answer) if each["type"] == "page"]
            if tabs:
                return str(tabs[0]["webSocketDebuggerUrl"])
        time.sleep(0.1)
    raise RuntimeError(f"{CHROMIUM} did not start (exit code {process.poll()})")
