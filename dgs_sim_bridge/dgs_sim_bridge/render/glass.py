"""What a stereo depth camera reports where it looks at glass and at mirrors.

Light that passes through glass is matched on what lies behind, light that is reflected elsewhere is not matched at all:
the two errors of Sajjan et al., "Clear Grasp", ICRA 2020, section III (background's depth, missing depth). No shares
are published; those below are assumed, and differ from object to object.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter
from scipy.special import ndtri

from dgs_sim_bridge.render.d455 import Image
from dgs_sim_bridge.render.raster import Rendering

GLASS_ERRORS, MIRROR_ERRORS = (0.35, 0.58, 0.05), (0.60, 0.30, 0.07)
"""Shares of the pixels inside a silhouette without depth; with that of what is behind (glass), or of the mirror's
picture, which lies behind its surface; in patches of a depth that belongs to nothing. The rest shows the surface."""
PATCH = 4.0
"""Radius (standard deviation) of the patches over which an error stays the same [px]."""
SPREAD = 0.4
"""By how much the shares differ from object to object [standard deviations of the patches' field]."""
RIM = 1
"""So far inside of its outline an object's rim can be matched [px] ..."""
RIM_KEPT = 0.3
"""... in this share of the patches."""
PICTURE_DEPTH = (0.05, 0.40)
"""How far behind a mirror's surface its picture lies [m]."""


def reported_depth(
    front: Rendering,
    behind: Rendering,
    glass: NDArray[np.bool_],
    mirror: NDArray[np.bool_],
    rng: np.random.Generator,
) -> Image:
    """Depth without the errors that every surface has (`D455Noise` adds those).

    Args:
        front: everything; behind: the same view without glass and mirrors.
        glass, mirror: (N,) which meshes are.
        rng: source of all randomness.

    Returns:
        (H, W) float32 [m], 0 = none.
    """
    depth = front.depth.copy()
    hit = front.ids >= 0
    owner = np.where(hit, front.ids, 0)
    shape = depth.shape
    field, other, kept = (_patches(shape, rng) for _ in range(3))
    field += rng.normal(0.0, SPREAD, len(glass)).astype(np.float32)[owner]
    size = 2 * RIM + 1
    outline = minimum_filter(front.ids, size) != maximum_filter(front.ids, size)
    rim = outline & (kept < ndtri(RIM_KEPT))
    picture = front.depth + np.float32(PICTURE_DEPTH[0]) + _uniform(other) * np.float32(np.ptp(PICTURE_DEPTH))
    for kind, errors, far in ((glass, GLASS_ERRORS, behind.depth), (mirror, MIRROR_ERRORS, picture)):
        inside = hit & kind[owner] & ~rim
        state = np.digitize(field, ndtri(np.cumsum(errors)))
        # Between half a step in front of the surface and half a step behind what lies behind it.
        wrong = front.depth + (2 * _uniform(other) - 0.5) * (far - front.depth)
        for number, value in enumerate((np.zeros_like(depth), far, np.where(far > 0, wrong, 0))):
            chosen = inside & (state == number)
            depth[chosen] = value[chosen]
    return depth


def _patches(shape: tuple[int, ...], rng: np.random.Generator) -> Image:
    """(H, W) smooth noise of zero mean and unit rms."""
    smooth = gaussian_filter(rng.standard_normal(shape, dtype=np.float32), PATCH, mode="wrap")
    return smooth * np.float32(2.0 * np.sqrt(np.pi) * PATCH)


def _uniform(field: Image) -> Image:
    """Smooth values in [0, 1] of a normal field."""
    return np.clip(np.float32(0.5) + field / np.float32(4.0), 0.0, 1.0)
