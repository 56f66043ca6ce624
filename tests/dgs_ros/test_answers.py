"""Answers that the middleware gives up are sent again."""

from __future__ import annotations

import warnings

import pytest

from dgs_ros import answers
from dgs_ros.answers import patiently

LOST = "failed to send response (timeout)"


class Middleware:
    """Gives the first answers up, in the words of rclpy's."""

    def __init__(self, given_up: int) -> None:
        self.given_up, self.tries = given_up, 0
        self.sent: list[str] = []

    def send(self, answer: str) -> None:
        self.tries += 1
        if self.tries <= self.given_up:
            warnings.warn(f"{LOST}: client will not receive response", RuntimeWarning, stacklevel=1)
            raise AssertionError("a warning was enough")
        self.sent.append(answer)

    def send_compiled(self, answer: str) -> None:
        """As a compiled function tells of a warning that has become an error."""
        try:
            self.send(answer)
        except RuntimeWarning as error:
            raise SystemError("returned a result with an exception set") from error


@pytest.mark.parametrize("compiled", [False, True])
def test_an_answer_is_sent_until_it_arrives(compiled: bool) -> None:
    middleware = Middleware(given_up=3)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="failed to send response")
        patiently(middleware.send_compiled if compiled else middleware.send)("yes")
    assert middleware.sent == ["yes"] and middleware.tries == 4


def test_patience_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answers, "PATIENCE", 0.0)
    middleware = Middleware(given_up=10**9)
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="failed to send response")
        patiently(middleware.send)("yes")
    assert not middleware.sent


def test_other_errors_are_none_of_its_business() -> None:
    def fail() -> None:
        raise SystemError("something else")

    with pytest.raises(SystemError, match="something else"):
        patiently(fail)()
