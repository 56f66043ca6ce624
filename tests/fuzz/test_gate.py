"""Whatever is sent to the live page's door, it comes in or is answered."""

from __future__ import annotations

from contextlib import closing
from http.cookies import CookieError, SimpleCookie

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dgs_viewer.gate import Gate
from tests.fuzz.cases import fuzz

LATIN = st.text(st.characters(max_codepoint=255), max_size=60)
FIELDS = st.dictionaries(st.sampled_from(["Host", "Origin", "Cookie", "Upgrade", "X"]), LATIN, max_size=5)


@pytest.fixture(scope="module")
def gates():
    inner = "127.0.0.1", 1
    with (
        closing(Gate("127.0.0.1", 0, inner)) as local,
        closing(Gate("127.0.0.1", 0, inner, "token")) as guarded,
    ):
        yield local, guarded


@fuzz
@example(line="GET / HTTP/1.1", fields={"Host": "[", "Origin": "http://["})
@example(line="GET //[ HTTP/1.1", fields={"Host": "127.0.0.1", "Cookie": "a b=c; ;=; \x00=1"})
@given(line=LATIN, fields=FIELDS)
def test_every_request_is_judged(gates, line: str, fields: dict[str, str]) -> None:
    head = "\r\n".join([line, *(f"{name}: {value}" for name, value in fields.items()), "", ""])
    for gate in gates:
        answer = gate.answer(head)
        assert answer == "" or answer.startswith("HTTP/1.1 ")
    if "token" not in line + fields.get("Cookie", ""):
        assert gates[1].answer(head) != ""


def test_the_library_refuses_some_cookies() -> None:
    with pytest.raises(CookieError):
        SimpleCookie()["a b"] = "c"
