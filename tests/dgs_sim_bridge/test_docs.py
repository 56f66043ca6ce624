"""docs/arm_controller.md names tests that exist."""

from __future__ import annotations

import re

from tests.support.environment import REPO_ROOT


def test_every_case_is_looked_at_or_does_not_apply() -> None:
    rows = re.findall(
        r"^\| (.+?) \| (.+?) \|$", (REPO_ROOT / "docs/arm_controller.md").read_text(), re.MULTILINE
    )[1:]
    assert len(rows) > 12
    folders = (REPO_ROOT / "tests/dgs_sim_bridge", REPO_ROOT / "tests/integration")
    text = "\n".join(path.read_text() for folder in folders for path in folder.rglob("test_*.py"))
    for case, here in rows:
        names = re.findall(r"`(test_\w+)`", here)
        assert names or here.startswith("does not apply: "), case
        assert all(f"def {name}(" in text for name in names), (case, names)
