"""The way the suite refuses an input."""

from __future__ import annotations

import pytest

from dgs_description.errors import DgsError, ErrorCode


def refused(code: ErrorCode, match: str | None = None) -> pytest.RaisesExc[DgsError]:
    """What is in the block raises a `DgsError` of this code, with a sentence in which `match` is found."""
    return pytest.raises(DgsError, match=match, check=lambda error: error.code == code)
