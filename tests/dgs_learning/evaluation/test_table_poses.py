"""The table is found from every camera pose of a small catalogue, and the command says so."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_learning.evaluation import table_poses
from dgs_learning.evaluation.table_poses import KINDS, draw_view, find, summarise
from dgs_sim_bridge.render.object_model import find_catalogue
from tests.support.commands import dgs

CATALOGUE = find_catalogue("novel")


@pytest.mark.parametrize("kind", KINDS)
def test_the_table_is_found_from_any_pose(kind: str) -> None:
    for turn in range(4):
        found = find(draw_view(CATALOGUE, 7, KINDS.index(kind) + turn * len(KINDS)))
        assert found.kind == kind
        assert found.good, (turn, found.angle, found.height, found.refused)


def test_views_are_drawn_by_seed_and_number() -> None:
    one, again, other = (draw_view(CATALOGUE, seed, 3) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.points, again.points)
    assert one.tilt != other.tilt


def test_a_wrong_table_is_counted_as_wrong_and_none_as_refused() -> None:
    view = draw_view(CATALOGUE, 0, 0)
    raised, empty = replace(view, seen=view.seen + 0.01 * view.normal), replace(view, points=view.points[:0])
    summary = summarise([find(view), find(raised), find(empty)])["all"]
    assert (summary["views"], summary["found"], summary["refused"]) == (3, 1, 1)


def test_the_command_writes_json_and_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    doc = tmp_path / "doc.md"
    doc.write_text("<!-- table-poses:start -->\n<!-- table-poses:end -->\n")
    monkeypatch.setattr(table_poses, "draw_view", lambda *_: draw_view(CATALOGUE, 0, 0))
    words = ["bench-table", "--views", "8", "--json", str(tmp_path / "out.json"), "--doc", str(doc)]
    dgs(words)
    assert json.loads((tmp_path / "out.json").read_text())["views"]["all"]["views"] == 8
    assert "| all | 8 | 100.0 |" in doc.read_text()
