"""The page's panel: what the suite says, and the buttons that steer it."""

from __future__ import annotations

from html import escape
from time import localtime, strftime
from typing import Protocol

import viser

from dgs_viewer.pointing import Box
from dgs_viewer.state import Event, Offer, Sample

_ROWS = 24
_COLOURS = ("#1f9d61", "#c98a00", "#d33f3f", "#888888")
"""By level of a diagnostic status: OK, WARN, ERROR, STALE."""
_PHONE = (
    "<style>@media (max-width:36em){.mantine-Paper-root[style*='20em'],.mantine-Paper-root div[style*='width: 20em']"
    "{width:100vw!important}.mantine-Paper-root[style*='20em']{max-height:48%!important}}</style>"
)
"""viser's panel for phones is 20em wide and covers more than half of the screen."""
_STYLE = "font-size:12px;line-height:1.45;padding:2px 12px 6px"
_STEADY = f"{_STYLE};height:11.6em;overflow-y:auto"
"""Of fixed height: whatever the suite says, no button moves away under a finger."""


class Commands(Protocol):
    """What the page can ask of the suite. Every call returns at once; what came of it stands in the log."""

    def stop(self) -> None:
        """Stop arm and hand."""

    def reset(self) -> None:
        """Allow motion again after a stop."""

    def clear(self, attempts: int, target: Box | None) -> None:
        """Clear the table, or what lies in a box; 0 attempts = as many as it takes."""

    def new_scene(self, seed: int, objects: int) -> None:
        """Put other objects onto the simulated table."""


class Panel:
    """Status, buttons, grasps, time.

    Attributes:
        target: the box in which grasps are wanted; None = the whole table.
        draw, forget: buttons to draw the target, and to give it up.
        click: whether a click on an object picks it.
        closed, most: share of the closing of the hands that are drawn, 0 to 1, and how many are.
        moment: place on the timeline, 0 = the beginning to 1 = live.
    """

    def __init__(self, server: viser.ViserServer, commands: Commands, simulated: bool):
        """Without a simulation there is no button for another scene."""
        gui = server.gui
        self._commands = commands
        gui.add_html(_PHONE)
        stop = gui.add_button("Stop", color="red", icon=viser.Icon.HAND_STOP)
        reset = gui.add_button("Allow motion again", icon=viser.Icon.LOCK_OPEN, color="gray")
        stop.on_click(lambda _: commands.stop())
        reset.on_click(lambda _: commands.reset())
        self._status = gui.add_html("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Steer", viser.Icon.ROBOT):
            self._steer(gui, simulated)
        with tabs.add_tab("Grasps", viser.Icon.HAND_GRAB):
            self.closed = gui.add_slider("pre-grasp to closed", 0.0, 1.0, 0.05, 1.0)
            self.most = gui.add_slider("hands shown", 0, 32, 1, 8)
            self._grasps = gui.add_html("")
        with tabs.add_tab("Time", viser.Icon.HISTORY):
            self.moment = gui.add_slider(
                "timeline", 0.0, 1.0, 0.002, 1.0, hint="drag left to look back; right = live"
            )
            live = gui.add_button("Back to live", icon=viser.Icon.PLAYER_TRACK_NEXT)
            self._log = gui.add_html("")
        live.on_click(lambda _: setattr(self.moment, "value", 1.0))
        self._shown: dict[int, str] = {}
        self.show_target(None)
        self.show_offer(None)

    def show_status(self, sample: Sample, live: bool, rates: dict[str, float], troubles: list[Event]) -> None:
        """Stage, sentence, counts, rates, and what is not well."""
        attempts, successes = sample.counts
        moment = "live" if live else strftime("%H:%M:%S", localtime(sample.time))
        pill = "#2b6cb0" if live else "#8a5a00"
        figures = ", ".join(f"{name} {rate:.0f} Hz" for name, rate in rates.items())
        ill = "".join(_sentence(trouble.level, trouble.code, trouble.text) for trouble in troubles)
        self._set(
            self._status,
            f'<div style="{_STEADY}"><span style="background:{pill};color:#fff;border-radius:9px;padding:1px 9px">'
            f'{moment}</span> <b style="font-size:15px">{escape(sample.stage)}</b><br>{escape(sample.sentence)}<br>'
            f'<span style="opacity:.7">{successes} of {attempts} attempts succeeded<br>{figures}</span>'
            f"{ill}</div>",
        )

    def show_offer(self, offer: Offer | None) -> None:
        """A row for each of the first predicted hands and the chosen one: score, proposer, and what the arm says."""
        if offer is None or len(offer.grasps) == 0:
            self._set(self._grasps, f'<div style="{_STYLE}">no grasps predicted</div>')
            return
        rows = []
        for k in [k for k in range(len(offer.grasps)) if k < _ROWS or k == offer.chosen]:
            code, reason = offer.refusals.get(k, (0, ""))
            verdict = "<b>chosen</b>" if k == offer.chosen else escape(f"{code}: {reason}") if code else ""
            score = float(offer.grasps.score[k])
            rows.append(
                f'<tr style="vertical-align:top"><td>{k + 1}</td><td>{score:.2f}</td>'
                f"<td>{escape(str(offer.grasps.source[k]))}</td><td>{verdict}</td></tr>"
            )
        more = len(offer.grasps) - len(rows)
        rest = f"<br>and {more} more" if more > 0 else ""
        head = "<tr style='text-align:left;opacity:.7'><th></th><th>score</th><th>source</th><th>the arm says</th></tr>"
        legend = "Blue is chosen, grey is refused, the others go from red (score 0) to green (1)."
        table = f'<table style="border-spacing:6px 1px;margin-left:-6px">{head}{"".join(rows)}</table>'
        self._set(self._grasps, f'<div style="{_STYLE}">{legend}{table}{rest}</div>')

    def show_log(self, events: list[Event]) -> None:
        """The newest lines, newest first."""
        lines = [
            _sentence(event.level, event.code, event.text, strftime("%H:%M:%S", localtime(event.time)))
            for event in events
        ]
        self._set(self._log, f'<div style="{_STYLE}">{"".join(lines) or "nothing yet"}</div>')

    def show_target(self, box: Box | None) -> None:
        """Where grasps are wanted from now on."""
        self.target = box
        if box is None:
            text = "Target: the whole table. Click an object, or draw a box."
        else:
            x, y, z = 100 * box.size
            text = f"Target: a box of {x:.0f} x {y:.0f} x {z:.0f} cm."
        self._set(self._where, f'<div style="{_STYLE}">{text}</div>')
        self.forget.disabled = box is None

    def _steer(self, gui: viser.GuiApi, simulated: bool) -> None:
        pick = gui.add_button("Pick one", icon=viser.Icon.HAND_GRAB)
        clear = gui.add_button("Clear the table", icon=viser.Icon.PLAYER_PLAY)
        pick.on_click(lambda _: self._commands.clear(1, self.target))
        clear.on_click(lambda _: self._commands.clear(0, self.target))
        self._where = gui.add_html("")
        self.draw = gui.add_button("Draw a target box", icon=viser.Icon.SQUARE, color="gray")
        self.forget = gui.add_button("Whole table", icon=viser.Icon.SQUARE_OFF, color="gray")
        self.click = gui.add_checkbox("a click on an object picks it", simulated)
        if not simulated:
            return
        with gui.add_folder("Simulated scene"):
            seed = gui.add_number("seed", 1, min=0, max=2**31, step=1)
            objects = gui.add_number("objects", 5, min=1, max=30, step=1)
            scene = gui.add_button("Another scene", icon=viser.Icon.REFRESH, color="gray")

        def renew(_: object) -> None:
            self._commands.new_scene(int(seed.value), int(objects.value))
            seed.value += 1  # type: ignore[misc]  # viser sets it by __setattr__

        scene.on_click(renew)

    def _set(self, html: viser.GuiHtmlHandle, content: str) -> None:
        """Send only what has changed."""
        if self._shown.get(id(html)) != content:
            self._shown[id(html)] = content
            html.content = content


def _sentence(level: int, code: int, text: str, time: str = "") -> str:
    colour = _COLOURS[min(level, len(_COLOURS) - 1)]
    number = f" ({code})" if code else ""
    style = f"border-left:3px solid {colour};padding-left:6px;margin-top:3px"
    return f'<div style="{style}">{time} {escape(text)}{number}</div>'
