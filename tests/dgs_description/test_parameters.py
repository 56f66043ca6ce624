"""Parameter dataclasses: what is accepted, what is refused and in which words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.parameters import constraints_of, declared, from_values, parameter
from tests.support.refused import refused


@dataclass(frozen=True)
class Settings:
    source: str = parameter("bag", "Where depth comes from.", choices=("bag", "camera"))
    rate: float = parameter(10.0, "Clouds per second [Hz].", minimum=0.5, maximum=30.0)
    threads: int = parameter(2, "Threads.", minimum=1)
    loop: bool = parameter(False, "Start again at the end.")
    topics: tuple[str, ...] = parameter((), "Topics.")
    corner: tuple[float, float, float] = parameter(
        (0.0, 0.0, 1.0), "A corner [m].", minimum=-2.0, maximum=2.0
    )

    def __post_init__(self) -> None:
        if self.loop and self.source == "camera":
            raise ValueError("a camera cannot loop")


def test_defaults_fill_what_is_not_given() -> None:
    assert from_values(Settings, {}) == Settings()


def test_values_arrive_in_their_declared_types() -> None:
    values = {
        "rate": 5,
        "topics": ["a", "b"],
        "corner": np.array([1, 2, -2]),
        "loop": True,
        "threads": np.int64(3),
    }
    settings = from_values(Settings, values)
    assert settings == Settings(rate=5.0, topics=("a", "b"), corner=(1.0, 2.0, -2.0), loop=True, threads=3)
    assert type(settings.rate) is float and type(settings.threads) is int


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"rat": 5.0}, "unknown parameter 'rat'; there are: corner, loop, rate"),
        ({"rate": 31.0}, "'rate' must be 0.5 to 30, got 31.0"),
        ({"rate": float("nan")}, "finite"),
        ({"rate": "fast"}, "must be a float, got 'fast'"),
        ({"rate": True}, "must be a float"),
        ({"threads": 0}, "'threads' must be at least 1, got 0"),
        ({"threads": 2.0}, "must be a int"),
        ({"loop": 1}, "must be a bool"),
        ({"source": "film"}, "one of 'bag', 'camera', got 'film'"),
        ({"topics": "a"}, "must be a list"),
        ({"topics": [1]}, "must be a str"),
        ({"corner": [1.0, 2.0]}, "must have 3 values, got 2"),
        ({"corner": [1.0, 2.0, 3.0]}, "-2 to 2, got 3.0"),
        ({"corner": None}, "must be a list"),
        ({"loop": True, "source": "camera"}, "a camera cannot loop"),
    ],
)
def test_refusals(values: dict[str, Any], words: str) -> None:
    with refused(ErrorCode.PARAMETER_INVALID, words):
        from_values(Settings, values)


def test_a_refusal_of_the_dataclass_keeps_its_own_code() -> None:
    @dataclass(frozen=True)
    class Strict:
        path: str = parameter("", "A file.")

        def __post_init__(self) -> None:
            raise DgsError(ErrorCode.BAG_MISSING, f"no bag at {self.path!r}")

    with refused(ErrorCode.BAG_MISSING, "no bag"):
        from_values(Strict, {"path": "x"})


def test_a_default_outside_its_own_bounds_is_found() -> None:
    @dataclass(frozen=True)
    class Wrong:
        rate: float = parameter(50.0, "Rate.", maximum=30.0)

    with refused(ErrorCode.PARAMETER_INVALID, "at most 30, got 50"):
        from_values(Wrong, {})


def test_optional_fields_are_a_programmers_mistake() -> None:
    @dataclass(frozen=True)
    class Wrong:
        rate: float | None = parameter(None, "Rate.")

    with pytest.raises(TypeError, match="optional"):
        from_values(Wrong, {})


def test_descriptions_can_be_read_back() -> None:
    found = constraints_of(Settings.__dataclass_fields__["rate"])
    assert (found.description, found.text()) == ("Clouds per second [Hz].", "0.5 to 30")


@dataclass(frozen=True)
class PathSettings:
    """Of some core module."""

    timeout: float = parameter(0.6, "Limit [s].", minimum=0.05)
    tries: int = 3


@dataclass(frozen=True)
class PathParameters(PathSettings):
    """A node's."""

    loop: bool = parameter(True, "Again at the end.")


def test_parameters_may_be_settings_whose_plain_fields_are_none() -> None:
    parameters = from_values(PathParameters, {"timeout": 2})
    assert isinstance(parameters, PathSettings) and parameters == PathParameters(2.0, 3, True)
    assert list(declared(PathParameters)) == ["timeout", "loop"]
    with refused(ErrorCode.PARAMETER_INVALID, "at least 0.05"):
        from_values(PathParameters, {"timeout": 0.0})
    with refused(ErrorCode.PARAMETER_INVALID, "unknown parameter 'tries'"):
        from_values(PathParameters, {"tries": 5})
