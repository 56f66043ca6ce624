"""How long something takes on a machine that does other things, too."""

from __future__ import annotations

import time
from collections.abc import Callable


def fastest(action: Callable[[], object], times: int = 5) -> float:
    """The least processor time of several runs [s]."""
    spent = []
    for _ in range(times):
        start = time.process_time()
        action()
        spent.append(time.process_time() - start)
    return min(spent)
