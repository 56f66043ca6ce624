"""What a checkpoint or a folder of views or trials was made from: it goes on with nothing else."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write


def check_same(said: str, made: Mapping[str, Any], own: Mapping[str, Any]) -> None:
    """Refuse, in a sentence that begins with `said`, what was made otherwise than `own` says.

    A key that `made` lacks is not compared: an older program wrote it.

    Raises:
        DgsError: REQUEST_INVALID.
    """
    differences = [
        f"{key} {made[key]} instead of {own[key]}" for key in own if made.get(key, own[key]) != own[key]
    ]
    if differences:
        raise DgsError(ErrorCode.REQUEST_INVALID, f"{said}: {', '.join(differences)}")


def mark_folder(folder: Path, own: Mapping[str, Any], name: str = "made_from.json") -> None:
    """Write into a folder, as file `name`, what its files are made from, JSON-ready.

    Raises:
        DgsError: REQUEST_INVALID: it holds others.
    """
    mark, text = folder / name, json.dumps(own)
    if mark.is_file():
        said = f"{folder} holds files of another dataset or with other settings, name another folder"
        check_same(said, json.loads(mark.read_text(encoding="utf-8")), json.loads(text))
        return
    with atomic_write(mark, "w") as file:
        file.write(text + "\n")
