"""docs/dataset.md names every array of the file, every file of an export, and commands and versions that exist."""

from __future__ import annotations

import re

import numpy as np

from dgs_learning import dataset
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
