"""The live page: scene and panel together, fed by a `ViewerState`, steering through `Commands`."""

from __future__ import annotations

import secrets
from contextlib import redirect_stdout
from io import StringIO

import numpy as np
import viser

from dgs_description.cell import CELL
from dgs_description.words import plural
from dgs_viewer.panel import Commands, Panel
from dgs_viewer.pointing import Box, ScreenCamera, box_around, hit, in_rectangle, object_at
from dgs_viewer.scene import Scene
from dgs_viewer.state import Sample, ViewerState

EYE, CENTRE = (CELL.T_base_table[:3, 3] + way for way in ((0.89, -0.79, 0.86), (-0.13, -0.02, 0.18)))
"""From where a new visitor looks, and to where [m]."""
FIELD_OF_VIEW = 1.0
"""Vertical [rad]."""
LIVE = 0.999
"""So far right on the timeline is now."""
_BELOW, _FARTHER = 0.6, 1.9
"""On a phone the view is centred so far below the scene [m], and looks from so many times the distance."""


class Page:
    """Serves the page on this machine alone; `gate` opens it to others."""

    def __init__(self, state: ViewerState, commands: Commands, simulated: bool) -> None:
        """Begin to serve on this machine alone, at an address that nobody guesses: viser lets in whoever finds it.

        Args:
            simulated: whether there is a simulation whose scene can be changed.
        """
        self._state, self._commands = state, commands
        # One of 16 million loopback addresses: a web page can try all ports of 127.0.0.1.
        host = ".".join(["127", *(str(1 + secrets.randbelow(254)) for _ in range(3))])
        with redirect_stdout(StringIO()):  # viser prints an address that is not the gate's
            self._server = viser.ViserServer(host=host, port=0, label="Dexterous grasping", verbose=False)
        self._server.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, brand_color=(60, 130, 220)
        )
        self._server.gui.set_panel_label("Dexterous grasping")
        self._server.initial_camera.position, self._server.initial_camera.look_at = EYE, CENTRE
        self._server.initial_camera.fov = FIELD_OF_VIEW
        self._scene = Scene(self._server)
        self._panel = Panel(self._server, commands, simulated)
        self._drawing = False
        self._panel.draw.on_click(lambda _: self._draw_target(not self._drawing))
        self._panel.forget.on_click(lambda _: self._aim(None))
        self._server.scene.on_click()(self._on_click)
        self._server.scene.on_rect_select(modifier="shift")(self._on_rectangle)
        self._server.on_client_connect(self._welcome)
        self._shown: tuple[object, ...] = (None,) * 3
        self._sample = Sample()
        self._frozen: tuple[float, float] | None = None

    @property
    def address(self) -> tuple[str, int]:
        """Host and port where it is served."""
        return self._server.get_host(), self._server.get_port()

    @property
    def seen(self) -> bool:
        """Whether somebody looks at it."""
        return bool(self._server.get_clients())

    def close(self) -> None:
        """End."""
        self._server.stop()

    def forget_target(self, box: Box | None) -> None:
        """The whole table is wanted again, unless another box than this one has been chosen meanwhile."""
        if self._panel.target is box:
            self._aim(None)

    def update(self, now: Sample, rates: dict[str, float]) -> None:
        """Show the newest moment, or the one that the timeline stands at."""
        live = self._live
        sample = now if live else self._past(float(self._panel.moment.value))
        if live:
            self._frozen = None
        self._sample = sample
        self._scene.show_robot(sample)
        cloud, offer, shape = self._shown
        if sample.cloud is not cloud:
            self._scene.show_cloud(sample.cloud)
        wanted = int(self._panel.most.value), float(self._panel.closed.value)
        if sample.offer is not offer or wanted != shape:
            self._scene.show_offer(sample.offer, *wanted)
        if sample.offer is not offer:
            self._scene.show_path(sample.offer)
            self._panel.show_offer(sample.offer)
        self._shown = sample.cloud, sample.offer, wanted
        self._panel.show_status(sample, live, rates, self._state.troubles())
        self._panel.show_log(self._state.recent(14))

    @property
    def _live(self) -> bool:
        return float(self._panel.moment.value) >= LIVE

    def _past(self, moment: float) -> Sample:
        """The remembered moment that the timeline stands at; it stays while the run goes on."""
        if self._frozen is None or self._frozen[0] != moment:
            first, last = self._state.span()
            self._frozen = moment, first + moment * (last - first)
        return self._state.at(self._frozen[1])

    # pointing

    def _on_click(self, event: viser.SceneClickEvent) -> None:
        points = self._points()
        index = hit(points, event.ray_origin, event.ray_direction)
        if index is None:
            return
        self._aim(box_around(points[object_at(points, index)]))
        if self._panel.click.value and self._live:  # what lay there once is not picked
            self._commands.clear(1, self._panel.target)

    def _on_rectangle(self, event: viser.SceneRectSelectEvent) -> None:
        if self._drawing:
            self._draw_target(False)
        points, camera = self._points(), event.client.camera
        screen = ScreenCamera(camera.position, camera.wxyz, camera.fov, camera.aspect)
        chosen = points[in_rectangle(points, screen, event.screen_min, event.screen_max)]
        if len(chosen):
            self._aim(box_around(chosen))
            held = f"the target box holds {plural(len(chosen), 'point')} of objects"
        else:  # the whole table instead would be more than was asked for
            held = "no object is under the rectangle: the target stays as it was"
        self._state.log(self._state.now.time, held)

    def _draw_target(self, on: bool) -> None:
        """Begin or end to draw a box; until then a drag does not turn the view."""
        self._drawing = on
        self._panel.draw.label = "Drag over the objects ..." if on else "Draw a target box"
        if on:
            self._server.scene.on_rect_select()(self._on_plain_rectangle)
        else:
            self._server.scene.remove_rect_select_callback(self._on_plain_rectangle)

    def _on_plain_rectangle(self, event: viser.SceneRectSelectEvent) -> None:
        self._on_rectangle(event)

    def _aim(self, box: Box | None) -> None:
        self._scene.show_target(box)
        self._panel.show_target(box)

    def _points(self) -> np.ndarray:
        """(N, 3) of the cloud on the page [m]."""
        cloud = self._sample.cloud
        return np.zeros((0, 3)) if cloud is None else cloud.points.astype(np.float64)

    def _welcome(self, client: viser.ClientHandle) -> None:
        """Who comes alone sees the present; on a screen that is higher than wide the scene needs more distance."""
        if len(self._server.get_clients()) <= 1:
            self._panel.moment.value = 1.0  # type: ignore[misc]  # viser sets it by __setattr__
        if client.camera.aspect < 1.0:
            centre = CENTRE - (0.0, 0.0, _BELOW)  # the panel covers the lower half
            client.camera.position = centre + _FARTHER * (EYE - CENTRE)
            client.camera.look_at = centre
