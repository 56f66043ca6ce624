"""`HAND`: the hand of this process, chosen once for all of them by the environment variable `DGS_HAND`."""

from __future__ import annotations

import os
import sys

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand_file import load_hand

CHOICE = "DGS_HAND"
"""Names a folder of `hands/`, or is the path of such a folder; unset = `DEFAULT`."""
DEFAULT = "dexhand_pro"

try:
    HAND = load_hand(os.environ.get(CHOICE) or DEFAULT)
except DgsError as error:  # here for all programs: none of them gets past this import
    print(f"{CHOICE}: {error.message} (code {int(error.code)})", file=sys.stderr)
    raise SystemExit(2) from None


def check_hand(stated: str, what: str) -> None:
    """Refuse data of another hand: raises DgsError WRONG_HAND where `stated` is not this process's."""
    if stated != HAND.name:
        cure = f"set {CHOICE}={stated}, or take those of this hand"
        raise DgsError(ErrorCode.WRONG_HAND, f"{what} are for the hand {stated}, not for {HAND.name}: {cure}")
