"""The D455 depth camera: its size and a noise model for rendered depth images (numpy and scipy only)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, uniform_filter

from dgs_description.camera import PinholeCamera

Image = NDArray[np.float32]


D455 = PinholeCamera(width=848, height=480, fx=447.0, fy=447.0, cx=423.5, cy=239.5)
"""Depth stream 848x480: 87 x 58 deg nominal."""
WINDOW = 7
"""Side of the matching window, over which the error is correlated [px]."""
EDGE_STEP = 1.0
"""Disparity step that counts as an edge [px]."""
MAX_RANGE = 6.0
"""No depth beyond [m]."""


@dataclass(frozen=True)
class D455Noise:
    """Errors of an active stereo camera; every one can be switched off with 0 or False.

    What edges do is set so that nine public frames of cameras of this family (D4xx, tables with things on them) and
    rendered ones agree: how wide the way from foreground to background is where depth has no gap there, how often it
    has one, and how much an edge wanders from row to row (docs/depth_sources.md).

    Attributes:
        subpixel_rms: rms of the matching error [px of disparity]; sigma_z = z^2 * rms / (f * baseline).
        bias_rms: rms of one disparity offset per image, for an imperfect calibration [px].
        quantisation: step of the disparity [px].
        edge_jitter: how far depth edges wander [px].
        smeared: share of the edges' length along which the matching window straddles them: depth runs from one side to
            the other like a curtain.
        dropped: share of the edges' length along which there is no depth.
        shadows: drop what the right imager cannot see: the left band, and a strip left of foreground objects.
        grazing_angle: incidence at which dropouts begin; certain at 88 degrees [rad]; 0 = off.
        max_disparity: search range of the matcher, sets the shortest distance [px].
        depth_unit: step of the output [m].
        baseline: distance of the stereo imagers [m].
    """

    subpixel_rms: float = 0.10
    bias_rms: float = 0.03
    quantisation: float = 1.0 / 32.0
    edge_jitter: float = 0.4
    smeared: float = 0.35
    dropped: float = 0.05
    shadows: bool = True
    grazing_angle: float = float(np.deg2rad(75.0))
    max_disparity: float = 126.0
    depth_unit: float = 0.001
    baseline: float = 0.095

    def apply(self, depth: NDArray, camera: PinholeCamera, rng: np.random.Generator) -> Image:
        """What the camera would deliver for an ideal depth image.

        Args:
            depth: (H, W) ideal depth [m], 0 = nothing there.
            rng: source of all randomness.

        Returns:
            (H, W) float32 depth [m], 0 = no depth.
        """
        depth = np.ascontiguousarray(depth, dtype=np.float32)
        focal_baseline = np.float32(camera.fx * self.baseline)
        disparity = np.divide(focal_baseline, depth, out=np.zeros_like(depth), where=depth > 0)
        keep = depth > 0
        if self.shadows:
            keep &= _seen_by_right_imager(disparity)
        if self.grazing_angle > 0:
            keep &= _not_grazing(depth, camera.fx, self.grazing_angle, rng)
        if self.edge_jitter > 0:
            disparity, keep = _jitter_edges(disparity, keep, self.edge_jitter, rng)
        if self.smeared > 0 or self.dropped > 0:
            disparity, keep = self._spoil_edges(disparity, keep, rng)
        if self.subpixel_rms > 0:
            disparity += np.float32(self.subpixel_rms) * correlated_noise(depth.shape, rng)
        if self.bias_rms > 0:
            disparity += np.float32(rng.normal(0.0, self.bias_rms))
        if self.quantisation > 0:
            step = np.float32(self.quantisation)
            disparity = np.rint(disparity / step) * step
        keep &= (disparity > focal_baseline / MAX_RANGE) & (disparity <= self.max_disparity)
        out = np.divide(focal_baseline, disparity, out=np.zeros_like(depth), where=keep)
        if self.depth_unit > 0:
            unit = np.float32(self.depth_unit)
            out = np.rint(out / unit) * unit
        return out

    def _spoil_edges(
        self, disparity: Image, keep: NDArray[np.bool_], rng: np.random.Generator
    ) -> tuple[Image, NDArray[np.bool_]]:
        """Smear disparity over some stretches of the edges and drop it along others."""
        edge = _edges(disparity)
        near = maximum_filter(edge, WINDOW, mode="constant")
        known = uniform_filter((disparity > 0).astype(np.float32), WINDOW)
        mean = uniform_filter(disparity, WINDOW) / np.maximum(known, np.float32(1e-3))
        height, width = disparity.shape
        stretch = 2 * WINDOW
        blocks = rng.random((height // stretch + 1, width // stretch + 1))
        fate = np.repeat(np.repeat(blocks, stretch, axis=0), stretch, axis=1)[:height, :width]
        smeared = near & (fate < self.smeared) & (disparity > 0)
        dropped = maximum_filter(edge, 3, mode="constant") & (fate > 1.0 - self.dropped)
        return np.where(smeared, mean, disparity), keep & ~dropped


def correlated_noise(shape: tuple[int, int], rng: np.random.Generator) -> Image:
    """(H, W) noise of zero mean and unit rms whose values within a matching window are correlated."""
    white = rng.standard_normal(shape, dtype=np.float32)
    # The mean of WINDOW^2 independent values has rms 1 / WINDOW; wrapping keeps that true at the borders.
    return uniform_filter(white, WINDOW, mode="wrap") * np.float32(WINDOW)


def _seen_by_right_imager(disparity: Image) -> NDArray[np.bool_]:
    """Pixels that the right imager sees too: it has u at u - d, unless something to the right covers that ray."""
    right = np.arange(disparity.shape[1], dtype=np.float32) - disparity
    nearest = np.minimum.accumulate(right[:, ::-1], axis=1)[:, ::-1]
    seen = right >= 0
    seen[:, :-1] &= nearest[:, 1:] > right[:, :-1] - np.float32(0.5)
    return seen


def _not_grazing(depth: Image, focal: float, angle: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Random dropouts where the surface is seen under more than `angle`, certain from 88 degrees on."""
    slope_u, slope_v = np.zeros_like(depth), np.zeros_like(depth)
    # The smaller of the differences to both sides: an edge of an object must not look like a steep surface.
    step = np.abs(np.diff(depth, axis=1))
    slope_u[:, 1:-1] = np.minimum(step[:, 1:], step[:, :-1])
    step = np.abs(np.diff(depth, axis=0))
    slope_v[1:-1] = np.minimum(step[1:], step[:-1])
    steep = np.flatnonzero((slope_u + slope_v) * np.float32(focal) > np.float32(np.tan(angle)) * depth)
    slope = np.hypot(slope_u.ravel()[steep], slope_v.ravel()[steep])
    tangent = slope * focal / np.maximum(depth.ravel()[steep], 1e-6)
    share = (np.arctan(tangent) - angle) / (np.deg2rad(88.0) - angle)
    keep = np.ones(depth.size, dtype=bool)
    keep[steep[rng.random(len(steep)) < share]] = False
    return keep.reshape(depth.shape)


def _jitter_edges(
    disparity: Image, keep: NDArray[np.bool_], amount: float, rng: np.random.Generator
) -> tuple[Image, NDArray[np.bool_]]:
    """Move depth edges by correlated random shifts; only the neighbourhood of edges changes."""
    height, width = disparity.shape
    rough = _edges(disparity)
    reach = int(np.ceil(2 * amount))
    near = uniform_filter(rough.astype(np.float32), 2 * reach + 1, mode="constant") > 1e-4
    v, u = np.nonzero(near)
    # One shift per block of `WINDOW` pixels is correlation enough and costs little.
    blocks = rng.normal(0.0, amount, size=(2, height // WINDOW + 1, width // WINDOW + 1))
    shift = np.clip(np.rint(blocks), -reach, reach).astype(np.int64)[:, v // WINDOW, u // WINDOW]
    source = np.clip(v + shift[0], 0, height - 1), np.clip(u + shift[1], 0, width - 1)
    moved, moved_keep = disparity.copy(), keep.copy()
    moved[v, u], moved_keep[v, u] = disparity[source], keep[source]
    return moved, moved_keep


def _edges(disparity: Image) -> NDArray[np.bool_]:
    edge = np.zeros(disparity.shape, dtype=bool)
    edge[:, 1:] = np.abs(np.diff(disparity, axis=1)) > EDGE_STEP
    edge[1:] |= np.abs(np.diff(disparity, axis=0)) > EDGE_STEP
    return edge
