"""arm_controller_cases.md lists every case once, and names tests that exist."""

from __future__ import annotations

import re

from tests.support.environment import REPO_ROOT

SECTIONS = (REPO_ROOT / "tests/dgs_sim_bridge/arm_controller_cases.md").read_text().split("\n## ")[1:]


def rows(section: str) -> list[tuple[str, str]]:
    return re.findall(r"^\| (.+?) \| (.+?) \|$", section, re.MULTILINE)[1:]


def test_every_case_is_looked_at_or_does_not_apply() -> None:
    folders = (REPO_ROOT / "tests/dgs_sim_bridge", REPO_ROOT / "tests/integration")
    text = "\n".join(path.read_text() for folder in folders for path in folder.rglob("test_*.py"))
    for case, here in (row for section in SECTIONS for row in rows(section)):
        names = re.findall(r"`(test_\w+)`", here)
        assert names or here.startswith("does not apply: "), case
        assert all(f"def {name}(" in text for name in names), (case, names)


def test_as_many_cases_are_listed_as_the_heading_says() -> None:
    counts = {}
    for section in SECTIONS:
        cases = [name for case, _ in rows(section) for name in re.findall(r"`(\w+)`", case)]
        assert len(cases) == len(set(cases)), section
        title, count = re.match(r"(.+) \((\d+) cases\)", section).groups()
        assert len(cases) == int(count), (title, len(cases))
        counts[title] = len(cases)
    assert sum(counts.values()) == 139, counts
