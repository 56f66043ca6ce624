"""The frame that the network works in: the table frame, or the camera frame of the paper."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.frames import Array, look_at


def table_from_input(frame: str, camera_position: ArrayLike) -> Array:
    """T_table_input, (4, 4): pose of the network's input frame in the table frame.

    Args:
        frame: `table`, or `camera` = an optical frame at the camera that looks at the table frame's origin. Its roll is
            that of a level camera, so only the position has to be known.
        camera_position: (3,) in the table frame [m].
    """
    if frame == "table":
        return np.eye(4)
    position = np.asarray(camera_position, dtype=np.float64)
    # Straight above the origin "up" has no direction in the image; any fixed one will do.
    up = (0.0, 0.0, 1.0) if np.hypot(position[0], position[1]) > 1e-3 * abs(position[2]) else (-1.0, 0.0, 0.0)
    return look_at(position, (0.0, 0.0, 0.0), up)
