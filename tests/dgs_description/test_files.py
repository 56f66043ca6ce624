"""Files are written whole, or stay as they were."""

from __future__ import annotations

from pathlib import Path

import pytest

from dgs_description.files import atomic_write


def test_the_file_appears_at_the_end_of_the_block(tmp_path: Path) -> None:
    path = tmp_path / "new" / "a.txt"
    with atomic_write(path, "w") as file:
        file.write("ä\r\n")
        assert not path.exists()
    assert path.read_bytes() == b"\xc3\xa4\r\n" and list(path.parent.iterdir()) == [path]


def test_after_an_error_the_old_file_stays(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with pytest.raises(OSError, match="no space"), atomic_write(path) as file:
        file.write(b"ne")
        raise OSError("no space")
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]
