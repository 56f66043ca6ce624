"""Where the checkout and its models lie, and what a measured number comes with: the checkout's revision, the date."""

from __future__ import annotations

import os
import subprocess
from datetime import UTC, datetime
from pathlib import Path

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import DEFAULT, HAND


def repository() -> Path:
    """Root of the checkout that this file lies in: as source, by a linked install, or by one below the checkout.

    Raises:
        DgsError: DESCRIPTION_MISSING: it lies in none.
    """
    for parent in Path(__file__).resolve().parents:
        if (parent / "models").is_dir() and (parent / "ros2_ws").is_dir():
            return parent
    lost = f"{__file__} lies in no checkout: set DGS_MODELS_DIR or the parameter models_dir"
    raise DgsError(ErrorCode.DESCRIPTION_MISSING, lost)


def models_dir(given: Path | str = "") -> Path:
    """Folder of weights, datasets and object catalogues: `given`, else $DGS_MODELS_DIR, else `models` of the checkout.

    Raises:
        DgsError: as `repository`; whether the folder exists is not looked at.
    """
    chosen = given or os.environ.get("DGS_MODELS_DIR", "")
    return Path(chosen).expanduser() if chosen else repository() / "models"


def weights_dir(given: Path | str = "") -> Path:
    """Folder of the hand's weights and dataset: `given`, else `models_dir`, or there the folder of another hand.

    Raises:
        DgsError: as `repository`.
    """
    if given:
        return Path(given).expanduser()
    return models_dir() if HAND.name == DEFAULT else models_dir() / HAND.name


_OF_PACKAGES = ("*.py", "*.json", "*.yaml", "*.urdf", ":!docs", ":!models")
"""Code and data of the packages; files in `models` have hashes of their own."""


def revision() -> str:
    """Short commit of the checkout, `+` behind it when code or data of a package differs; "unknown" without git."""

    def git(*words: str) -> str:
        command = ["git", "-C", str(repository()), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout.strip()

    try:
        head = git("rev-parse", "--short=10", "HEAD")
        changed = git("status", "--porcelain", "--untracked-files=no", "--", *_OF_PACKAGES)
    except (OSError, subprocess.SubprocessError, DgsError):
        return "unknown"
    return head + ("+" if changed else "")


def today() -> str:
    """Date in UTC, e.g. 2026-01-31."""
    return datetime.now(UTC).date().isoformat()
