"""The suite's URDF files: `python -m dgs_description.urdf` rewrites them, `urdf_path` finds them.

This Python is their only source; there is no xacro.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from argparse import ArgumentParser
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from dgs_description import urdf_parts as parts
from dgs_description.arm_kinematics import CHOICE as ARM
from dgs_description.cell import CHOICE as CELL_FILE
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write
from dgs_description.frames import TOOL0
from dgs_description.hand import CHOICE as HAND_CHOICE
from dgs_description.hand import DEFAULT
from dgs_description.urdf_writer import Joint, Robot, to_urdf

PACKAGE = "dgs_description"


def robot() -> Robot:
    """UR3 with the DexHand Pro on its flange; root `base_link`."""
    hand, mount = parts.hand(), Joint("hand_mount_fixed", TOOL0, parts.HAND_MOUNT)
    arm_and_hand = parts.arm() + replace(hand, joints=(mount, *hand.joints))
    return replace(arm_and_hand, name="dgs_robot")


def cell() -> Robot:
    """Robot and surroundings in one tree; root `base_link`."""
    around = parts.surroundings()
    return replace(robot() + replace(around, links=around.links[1:]), name="dgs_cell")


_FILES: dict[str, tuple[Callable[[], Robot], Callable[[Robot], str]]] = {
    "cell": (cell, to_urdf),
    "robot": (robot, to_urdf),
    "surroundings": (parts.surroundings, to_urdf),
    "dexhand": (parts.hand, to_urdf),
    "floating_hand": (parts.floating_hand, partial(to_urdf, visuals=False)),
    "cell_ros": (cell, partial(to_urdf, capsules=False)),
    "dexhand_ros": (parts.hand, partial(to_urdf, capsules=False)),
}
NAMES = tuple(_FILES)
"""Names that `urdf_path` and `urdf_text` know; see docs/hand.md for what each is for."""


def urdf_text(name: str) -> str:
    """URDF text of one of `NAMES`, made anew.

    Raises:
        DgsError: unknown name.
    """
    _check(name)
    build, write = _FILES[name]
    return write(build())


def urdf_path(name: str) -> Path:
    """The file of one of `NAMES`, in the source tree or in an installed `share/dgs_description/urdf`.

    Those files have the default hand, the nominal arm and the default cell; with others it is made at the first call,
    in a folder for temporary files.

    Raises:
        DgsError: unknown name, or no such file in either place.
    """
    _check(name)
    if not _as_written():
        return _made(name)
    for folder in _folders():
        path = folder / f"{name}.urdf"
        if path.is_file():
            return path
    places = ", ".join(str(folder) for folder in _folders())
    missing = f"{name}.urdf is in none of {places}; run `python -m {PACKAGE}.urdf`"
    raise DgsError(ErrorCode.DESCRIPTION_MISSING, missing)


def _as_written() -> bool:
    """Whether this process has the hand, arm and cell of those files; a folder of the default hand's name has not."""
    chosen = os.environ.get(HAND_CHOICE) or DEFAULT
    return chosen == DEFAULT and not (os.environ.get(ARM) or os.environ.get(CELL_FILE))


def _made(name: str) -> Path:
    """The file of another hand, arm or cell, made anew where its text has changed."""
    text = urdf_text(name)
    folder = Path(tempfile.gettempdir()) / f"dgs_urdf_{os.getuid()}"
    path = folder / f"{name}_{hashlib.sha256(text.encode()).hexdigest()[:16]}.urdf"
    if not path.is_file():
        folder.mkdir(mode=0o700, exist_ok=True)
        with atomic_write(path, "w") as file:
            file.write(text)
    return path


def _check(name: str) -> None:
    if name not in NAMES:
        raise DgsError(ErrorCode.DESCRIPTION_MISSING, f"no URDF named {name!r}; there are {', '.join(NAMES)}")


def _folders() -> list[Path]:
    """Where the files may lie: next to the package (source tree), or in the share folder of its install."""
    package = Path(__file__).resolve().parent
    prefixes = [*package.parents, Path(sys.prefix)]
    return [package.parent / "urdf", *(prefix / "share" / PACKAGE / "urdf" for prefix in prefixes)]


if __name__ == "__main__":
    ArgumentParser(description="Write the URDFs anew.").parse_args()
    if not _as_written():
        sys.exit(
            f"the files are those of the default hand, arm and cell: unset {HAND_CHOICE}, {ARM}, {CELL_FILE}"
        )
    folder = _folders()[0]
    folder.mkdir(exist_ok=True)
    for name in NAMES:
        (folder / f"{name}.urdf").write_text(urdf_text(name))
        print(f"wrote {folder / name}.urdf")
