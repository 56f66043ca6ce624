"""docs/dataset.md names arrays, files and versions that exist; measured tables are those of their files."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from dgs_learning import dataset
from dgs_learning.evaluation.report.templates import render
from dgs_learning.export import layout
from tests.dgs_learning.small_dataset import small_dataset_file
from tests.support.environment import REPO_ROOT

TEXT = (REPO_ROOT / "docs" / "dataset.md").read_text()


def test_every_array_of_the_file_is_described() -> None:
    section = TEXT.split("## The dataset file")[1].split("##")[0]
    cells = [line.split("|")[1] for line in section.splitlines() if line.startswith("| `")]
    described = {name for cell in cells for name in re.findall(r"`(\w+)`", cell)}
    with np.load(small_dataset_file(), allow_pickle=False) as arrays:
        assert set(arrays.files) == described
    assert f"(version {dataset.VERSION})" in TEXT


def test_every_file_of_an_export_is_described() -> None:
    assert f"(layout version {layout.VERSION})" in TEXT
    for folder, suffix in layout.FOLDERS.items():
        assert f"{folder}/0000.{suffix}" in TEXT


@pytest.mark.parametrize(
    ("template", "measured", "document"),
    [
        ("depth_edges", "depth_edges", "depth_sources"),
        ("paths", "paths", "arm_executor"),
        ("planning", "arm_planning", "arm_executor"),
        ("success", "success", "ranking"),
        ("table_poses", "table_poses", "training"),
    ],
)
def test_the_documents_table_is_that_of_the_measured_file(
    template: str, measured: str, document: str
) -> None:
    values = json.loads((REPO_ROOT / "docs" / "results" / f"{measured}.json").read_text())
    assert render(f"{template}.md", m=values) in (REPO_ROOT / "docs" / f"{document}.md").read_text()
