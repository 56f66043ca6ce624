"""What counts as abandoned shared memory."""

from __future__ import annotations

import fcntl
from pathlib import Path

from dgs_ros.shared_memory import remove_abandoned

NAME = "fastrtps_0123456789abcdef"


def test_only_unlocked_segments_of_fast_dds_go(tmp_path: Path) -> None:
    locked = tmp_path / NAME
    abandoned = tmp_path / NAME.replace("0", "f")
    others = [
        tmp_path / name for name in ("fastrtps_port7411", "sem.fastrtps_port7411_mutex", "mine", NAME + "0")
    ]
    for path in (locked, abandoned, *others):
        path.write_bytes(bytes(100))
        path.with_name(f"{path.name}_el").touch()
    with (tmp_path / f"{NAME}_el").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert remove_abandoned(tmp_path) == 100
        assert not abandoned.exists() and not abandoned.with_name(f"{abandoned.name}_el").exists()
        assert locked.exists() and all(path.exists() for path in others)
    assert remove_abandoned(tmp_path) == 100  # its process has ended
    assert not locked.exists() and all(path.exists() for path in others)
