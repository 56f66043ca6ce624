"""Poses of fixed frames in `base_link`, from parameters and from what /tf_static says."""

from __future__ import annotations

import threading

import numpy as np

from dgs_description.frames import BASE_LINK, Array, inverse


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
        """T_base_frame, (4, 4); None if known transforms do not join `frame` and `base_link`."""
        with self._lock:
            frames, bases = self._above(frame.lstrip("/")), self._above(BASE_LINK)
        for name, T_name_base in bases.items():
            if name in frames:
                return frames[name] if name == BASE_LINK else inverse(T_name_base) @ frames[name]
        return None

    def _above(self, name: str) -> dict[str, Array]:
        """Pose of a frame in itself, its parent, and so on upwards; a loop in the transforms ends it."""
        T_name_frame = np.eye(4)
        found = {name: T_name_frame}
        while name in self._parents and self._parents[name][0] not in found:
            name, T_parent_child = self._parents[name]
            T_name_frame = T_parent_child @ T_name_frame
            found[name] = T_name_frame
        return found
