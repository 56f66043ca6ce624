"""Settings of glibc's malloc for this process; with another C library nothing happens."""

from __future__ import annotations

import ctypes
from contextlib import suppress

TRIM_THRESHOLD, MMAP_THRESHOLD, ARENA_MAX = -1, -3, -8
"""Parameters of mallopt(3)."""


def mallopt(parameter: int, value: int) -> None:
    """Set one of the parameters; see mallopt(3)."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").mallopt(parameter, value)


def trim() -> None:
    """Hand memory that is free inside the heap back to the kernel."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL("libc.so.6").malloc_trim(0)
