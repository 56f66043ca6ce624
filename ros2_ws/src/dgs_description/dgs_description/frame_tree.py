"""Poses of fixed frames in `base_link`, from parameters and from what /tf_static says."""

from __future__ import annotations

import threading

import numpy as np

from dgs_description.frames import BASE_LINK, Array


class FrameTree:
    """Static transforms by child frame; safe to use from several threads."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Array]] = {}
        self._lock = threading.Lock()

    def set(self, parent: str, child: str, T_parent_child: Array) -> None:
        """Add or replace the (4, 4) pose of `child` in `parent`; leading slashes do not count."""
        with self._lock:
            self._parents[child.lstrip("/")] = (parent.lstrip("/"), T_parent_child)

    def pose(self, frame: str) -> Array | None:
        """T_base_frame, (4, 4); None if no chain of known transforms leads from `frame` to `base_link`."""
        T_base_frame = np.eye(4)
        name = frame.lstrip("/")
        with self._lock:
            for _ in range(len(self._parents) + 1):  # a loop in the transforms ends here
                if name == BASE_LINK:
                    return T_base_frame
                if name not in self._parents:
                    return None
                name, T_parent_child = self._parents[name]
                T_base_frame = T_parent_child @ T_base_frame
        return None
