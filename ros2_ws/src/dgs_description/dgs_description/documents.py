"""Measured tables in documents: a command writes what stands between two marks."""

from __future__ import annotations

from pathlib import Path


def fill_block(document: Path, name: str, text: str) -> bool:
    """Replace what stands between `<!-- NAME:start -->` and `<!-- NAME:end -->`; returns whether that changed the file.

    Raises:
        ValueError: the document lacks the marks.
    """
    start, end = f"<!-- {name}:start -->", f"<!-- {name}:end -->"
    old = document.read_text(encoding="utf-8")
    if start not in old or end not in old:
        raise ValueError(f"{document} has no {start} ... {end}")
    before, rest = old.split(start, 1)
    new = f"{before}{start}\n{text}\n{end}{rest.split(end, 1)[1]}"
    if new != old:
        document.write_text(new, encoding="utf-8")
    return new != old
