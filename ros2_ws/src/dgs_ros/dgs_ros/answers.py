"""Answers reach their clients also when server and client do not fully know each other yet.

A server that has just come up may hear a request before discovery has told it where the client listens. The middleware
waits 0.1 s, gives the answer up with a warning, and the client waits for ever. On a busy machine that is too short.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

PATIENCE = 5.0
"""How long an answer is tried again [s]; a client that has gone is known sooner."""
_GIVEN_UP = "failed to send response"

# rclpy only warns. As an error it comes out of a compiled function as a SystemError whose cause is the warning.
warnings.filterwarnings("error", message=_GIVEN_UP, category=RuntimeWarning)


def patiently(send: Callable[..., Any]) -> Callable[..., None]:
    """`send`, tried again while the middleware gives up; what is not sent after `PATIENCE` is lost."""

    def try_again(*arguments: Any) -> None:
        end = time.monotonic() + PATIENCE
        while True:
            try:
                send(*arguments)
                return
            except (RuntimeWarning, SystemError) as error:
                if _GIVEN_UP not in f"{error} {error.__cause__}":
                    raise
                if time.monotonic() > end:
                    return

    return try_again
