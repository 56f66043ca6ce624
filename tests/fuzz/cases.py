"""How many cases, and hostile ones: messages with wrong fields, files with wrong bytes."""

from __future__ import annotations

import copy
import os
import random
from array import array
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

CASES = int(os.environ.get("DGS_FUZZ_CASES", "40"))
"""Per property; `make soak` asks for more."""
fuzz = settings(
    max_examples=CASES,
    deadline=None,
    derandomize="DGS_FUZZ_CASES" not in os.environ,
    print_blob=True,
    suppress_health_check=list(HealthCheck),
)
"""In `make test` always the same cases; in `make soak` new ones, and a failure prints how to repeat it."""

NUMBERS = st.one_of(
    st.floats(), st.sampled_from([0.0, -0.0, 1e-300, 1e300, float("nan"), float("inf"), -float("inf")])
)
WORDS = st.one_of(
    st.text(max_size=20),
    st.sampled_from(["", "/", "base_link", "x" * 100_000, "\n", "../../etc/passwd", "nan", "joint\u0000"]),
)
_WIDTHS = {"8": 8, "16": 16, "32": 32, "64": 64}


@st.composite
def hostile(draw: st.DrawFn, message: Any) -> Any:
    """A copy of a ROS message with one to four of its fields, at any depth, set to what nobody expects."""
    message = copy.deepcopy(message)
    for _ in range(draw(st.integers(1, 4))):
        owner = message
        while True:
            kinds = owner.get_fields_and_field_types()
            name = draw(st.sampled_from(sorted(kinds)))
            value, kind = getattr(owner, name), kinds[name]
            inner = value[0] if isinstance(value, list) and value else value
            if not hasattr(inner, "get_fields_and_field_types") or draw(st.integers(0, 4)) == 0:
                break
            owner = draw(st.sampled_from(value)) if isinstance(value, list) else value
        _set(draw, owner, name, kind, value)
    return message


def _set(draw: st.DrawFn, owner: Any, name: str, kind: str, value: Any) -> None:
    element = kind.removeprefix("sequence<").split("[")[0].rstrip(">").split("<")[0]
    if element == kind:
        if not hasattr(value, "get_fields_and_field_types"):
            setattr(owner, name, draw(_scalar(element)))
    elif "[" in kind:  # of a fixed length
        if not hasattr(value[0], "get_fields_and_field_types"):
            values = draw(st.lists(_scalar(element), min_size=len(value), max_size=len(value)))
            setattr(owner, name, values)
    elif element == "uint8":
        setattr(owner, name, array("B", draw(st.binary(max_size=200))))
    elif "/" in element:  # of messages: fewer, or more of the same
        setattr(owner, name, list(value)[: draw(st.integers(0, 3))] * draw(st.integers(0, 3)))
    else:
        setattr(owner, name, draw(st.lists(_scalar(element), max_size=30)))


def _scalar(kind: str) -> st.SearchStrategy:
    if kind in ("string", "wstring"):
        return WORDS
    if kind in ("boolean", "bool"):
        return st.booleans()
    if kind == "float":
        return st.floats(width=32)
    if kind == "double":
        return NUMBERS
    if kind in ("octet", "byte"):
        return st.binary(min_size=1, max_size=1)
    bits = next(width for digits, width in _WIDTHS.items() if kind.endswith(digits))
    low, high = (0, 2**bits - 1) if kind.startswith("u") else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return st.one_of(st.integers(low, high), st.sampled_from([low, high, 0, 1]))


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """A file's content with bytes changed, cut out, doubled or cut off; now and then something else altogether."""
    way = draw(st.sampled_from(["change", "cut", "double", "end", "other"]))
    rng = random.Random(draw(st.integers(0, 2**32)))
    data = bytearray(content)
    if way == "other" or not data:
        return draw(st.binary(max_size=300))
    start = rng.randrange(len(data))
    stop = min(len(data), start + rng.choice([1, 4, 64, 1000]))
    if way == "change":
        for _ in range(rng.choice([1, 1, 3, 20])):
            data[rng.randrange(len(data))] = rng.randrange(256)
    elif way == "cut":
        del data[start:stop]
    elif way == "double":
        data[start:start] = data[start:stop]
    else:
        del data[start:]
    return bytes(data)
