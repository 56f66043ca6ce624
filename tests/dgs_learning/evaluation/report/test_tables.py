"""Results of experiments as JSON and as tables in documents."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dgs_grasp_planner.planner import SHIPPED, STAGES
from dgs_learning.cli.files import write_json
from dgs_learning.evaluation.experiment import Experiment, Row
from dgs_learning.evaluation.metrics import summarise
from dgs_learning.evaluation.report.tables import (
    experiment_result,
    experiment_table,
    fill_document,
    read_result,
    together,
)
from dgs_learning.evaluation.report.templates import planner_label
from tests.support.commands import dgs


def summary_of(row: Row) -> dict:
    setting = {
        "proposers": list(row.proposers), "stages": list(row.stages), "ablate": row.ablate, "scenes": row.scenes,
        "objects_per_scene": list(row.objects_per_scene), "area": list(row.workspace), "objects": {"name": "novel"},
        "seed": row.seed, "revision": "abc", "date": "2026-01-01", "model_sha256": "feed",
    }  # fmt: skip
    return {
        **summarise([]),
        "scenes": row.scenes,
        "proposers": list(row.proposers),
        "stages": list(row.stages),
        "setting": setting,
    }


def result_of(*rows: Row, paper: tuple[str, ...] = ()) -> dict:
    return experiment_result(
        Experiment("chain", "t", rows, paper, "chain"), [summary_of(row) for row in rows]
    )


def lines(table: str) -> list[str]:
    return [line for line in table.splitlines() if line.startswith("|")]


def test_labels_say_who_proposes_and_what_follows() -> None:
    def label(**changes: object) -> str:
        return planner_label(summary_of(Row("a", **changes))["setting"])  # type: ignore[arg-type]

    alone = {"proposers": ("dgs_net",), "without": STAGES}
    ships = "DGS-Net + level pinches + edge pinches + turns over + drags + pushes + partings + contact + check + rank"
    assert label() == f"planner ({ships})"
    assert label(**alone) == "DGS-Net"
    assert label(**alone, ablate="offset") == "DGS-Net, without offset"
    assert label(proposers=("random_prior",), without=("rank",)) == "random prior + contact + check"
    assert label(proposers=SHIPPED[:2], without=("rank",)) == "DGS-Net + level pinches + contact + check"


def test_a_table_has_a_row_for_each_run_and_those_of_the_paper() -> None:
    result = result_of(Row("one", text="text of one"), Row("two"), paper=("table_2", "table_5"))
    assert [row["name"] for row in result["rows"]] == ["one", "two"]
    table = experiment_table(result)
    head, _, one, two, *paper = lines(table)
    assert one.startswith("| text of one |") and two.startswith("| planner (")
    assert [line.split("|")[2].strip() for line in paper] == ["69.8", "71.1", "74.8"]
    assert {line.count("|") for line in lines(table)} == {head.count("|")}
    assert "60 scenes of 4-6 objects (novel) in 0.4 x 0.8 m; seed 0; weights `feed`; revision `abc`" in table


def test_settings_that_differ_stand_in_the_rows() -> None:
    table = experiment_table(result_of(Row("a"), Row("b", objects_per_scene=(10, 10), workspace=(0.6, 0.6))))
    _, _, few, ten = lines(table)
    assert "of 4-6 objects" in few and "of 10 objects (novel) in 0.6 x 0.6 m" in ten


def test_sets_of_objects_are_taken_together_per_engine_and_condition() -> None:
    rows = [
        {"text": text, "successes": good, "attempts": good + 2, "cleared": good, "objects": 10}
        for text, good in (("novel, PyBullet", 10), ("novel, MuJoCo", 8), ("real, PyBullet", 6))
    ]
    bullet, mujoco = together(rows)
    assert (bullet["text"], bullet["sr"], bullet["cr_pooled"]) == ("PyBullet", 16 / 20, 16 / 20)
    assert (mujoco["text"], mujoco["sr"], mujoco["cr_pooled"]) == ("MuJoCo", 8 / 10, 8 / 10)


def test_the_exam_tells_no_success_of_what_was_not_tried() -> None:
    result = result_of(Row("one", text="novel, PyBullet")) | {"by_kind": True}
    (row,) = result["rows"]
    row["per_kind"]["low"] |= {"objects": 3, "cr_interval": (0.0, 0.56)}
    row["per_kind"]["wide"] |= {"objects": 1, "attempts": 2, "sr": 0.5, "sr_interval": (0.1, 0.9)}
    row["setting"]["objects"]["sha256"] = "ff"
    cells = experiment_table(result).splitlines()[2].split(" | ")
    assert cells[2:5] == ["–", "– / 0.0 (0.0–56.0) of 3", "50.0 (10.0–90.0) / 0.0 (0.0–100.0) of 1"]


def test_a_result_goes_to_a_file_and_from_there_between_the_marks_of_a_document(tmp_path: Path) -> None:
    file, page = tmp_path / "results" / "chain.json", tmp_path / "page.md"
    write_json(file, result_of(Row("one", text="text of one")))
    assert read_result(file)["rows"][0]["sr_interval"] == [0.0, 1.0]
    page.write_text("before\n<!-- chain:start -->\nold\n<!-- chain:end -->\nafter\n")
    assert "chain rewritten" in dgs(["report", str(file), "--doc", str(page)]).output
    assert not fill_document(page, read_result(file))
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("-->\nafter\n")
    assert text.count("text of one") == 1 and "old" not in text
    page.write_text("nothing")
    with pytest.raises(ValueError, match="chain:start"):
        fill_document(page, read_result(file))


def test_brief_marks_take_what_ships_beside_the_paper(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("<!-- chain-brief:start -->\n<!-- chain-brief:end -->\n")
    result = result_of(Row("what_ships"), Row("network", proposers=("dgs_net",)), paper=("table_3",))
    assert fill_document(page, result)
    _, _, ours, *paper = lines(page.read_text())
    assert "this suite | 60 scenes of 4-6 objects (novel)" in ours
    assert [line.split("|")[1:4:2] for line in paper][0] == [" *paper: DGS-Net* ", " 74.8 "]
    assert all("paper: DGS-Net" in line for line in paper)


@pytest.mark.parametrize("content", ["[1]", "{}", "no JSON", json.dumps({"series": "old"})])
def test_other_files_are_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(content)
    with pytest.raises(ValueError, match=r"a\.json"):
        read_result(tmp_path / "a.json")
