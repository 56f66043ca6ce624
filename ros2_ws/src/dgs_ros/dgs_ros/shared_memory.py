"""Removes the shared memory of processes that were killed: python -m dgs_ros.shared_memory

Every process with Fast DDS has segments of up to 64 MiB in /dev/shm and holds a lock on `NAME_el` for each. A process
that is killed cannot remove them; the kernel only frees the locks.
"""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

SHARED_MEMORY = Path("/dev/shm")
_SEGMENT = re.compile(r"fastrtps_[0-9a-f]{16}")


def segments(folder: Path = SHARED_MEMORY) -> list[Path]:
    """Fast DDS's own data segments that belong to this user."""
    own = []
    for path in folder.glob("fastrtps_*"):
        with suppress(FileNotFoundError):
            if _SEGMENT.fullmatch(path.name) and path.lstat().st_uid == os.getuid():
                own.append(path)
    return own


def remove_abandoned(folder: Path = SHARED_MEMORY) -> int:
    """Remove the segments whose lock nobody holds and that no process maps; returns how many bytes they had."""
    unlocked = [path for path in segments(folder) if _is_free(path.with_name(f"{path.name}_el"))]
    size = 0
    for path in set(unlocked) - (_mapped() if unlocked else set()):
        with suppress(FileNotFoundError):
            size += path.stat().st_size
            path.unlink()
        path.with_name(f"{path.name}_el").unlink(missing_ok=True)
    return size


def _is_free(lock: Path) -> bool:
    try:
        with lock.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return True


def _mapped() -> set[Path]:
    """Segments that processes have mapped, also of processes in the middle of making one."""
    return {
        Path(name) for maps in _maps() for name in re.findall(rf"{SHARED_MEMORY}/fastrtps_[0-9a-f]+", maps)
    }


def _maps() -> Iterable[str]:
    for process in Path("/proc").glob("[0-9]*/maps"):
        with suppress(OSError):  # it has ended, or is somebody else's
            yield process.read_text(errors="replace")


if __name__ == "__main__":
    print(f"removed {remove_abandoned() / 2**20:.0f} MiB of shared memory that no process used")
