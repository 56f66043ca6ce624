from __future__ import annotations

import json
from pathlib import Path

import pytest

from dgs_description.documents import fill_block
from dgs_learning import paths
from dgs_learning.evaluation.report.templates import render
from dgs_learning.planning.measure import summarise
from tests.dgs_learning.planning.cells import record


def test_the_documents_table_is_that_of_the_measured_file() -> None:
    measured = json.loads((paths.repository() / "docs/results/arm_planning.json").read_text())
    assert render("planning.md", m=measured) in (paths.repository() / "docs/arm_executor.md").read_text()


def test_a_document_without_marks_is_refused(tmp_path: Path) -> None:
    document = tmp_path / "d.md"
    document.write_text("nothing here")
    measured = summarise([record(1, 0, 0)]) | {
        "command": "", "date": "", "machine": {"processor": "", "load_average": 0.0, "cores": 1},
    }  # fmt: skip
    with pytest.raises(ValueError, match="planning:start"):
        fill_block(document, "planning", render("planning.md", m=measured))
    document.write_text("before <!-- planning:start -->old<!-- planning:end --> after")
    fill_block(document, "planning", render("planning.md", m=measured))
    assert "| 1, 100 |" in document.read_text() and "old" not in document.read_text()
