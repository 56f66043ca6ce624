"""Experiments from YAML: what is shipped can be read, what is misspelt is refused with the names that there are."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from dgs_grasp_planner.planner import SHIPPED, STAGES
from dgs_learning.evaluation.conditions import Condition
from dgs_learning.evaluation.experiment import Row, names, read_experiment
from dgs_learning.evaluation.proposers import planner_of
from dgs_learning.evaluation.provenance import describe_planner


def written(folder: Path, text: str) -> str:
    file = folder / "mine.yaml"
    file.write_text(text)
    return str(file)


@pytest.mark.parametrize("name", names())
def test_shipped_experiments_can_be_read_and_have_rows_that_differ(name: str) -> None:
    experiment = read_experiment(name, {})
    assert experiment.text and experiment.mark
    described = [
        json.dumps(
            [
                describe_planner(row),
                row.condition.described(),
                row.objects,
                row.engine,
                *row.objects_per_scene,
            ]
        )
        + str(row.arm)
        for row in experiment.rows
    ]
    assert len(set(described)) == len(experiment.rows) >= 2
    assert len({row.name for row in experiment.rows}) == len(experiment.rows)


def test_a_row_is_what_ships_unless_it_says_otherwise(tmp_path: Path) -> None:
    text = "text: t\nrows:\n  - {name: a}\n  - {name: b, proposers: [dgs_net], without: [rank, contact]}\n"
    first, second = read_experiment(written(tmp_path, text), {"scenes": 3}).rows
    assert (first.proposers, first.stages, first.scenes) == (SHIPPED, STAGES, 3)
    assert (second.proposers, second.stages) == (("dgs_net",), ("check",))


def test_defaults_and_the_command_line_stand_behind_what_a_row_says(tmp_path: Path) -> None:
    text = """
text: t
defaults: {scenes: 7, seed: 5, objects_per_scene: [2, 3]}
rows:
  - {name: a, condition: {noise: 2, elevation: [12, 20]}}
  - {name: b, scenes: 25}
"""
    a, b = read_experiment(written(tmp_path, text), {"scenes": 4}).rows
    assert (a.scenes, a.seed, a.objects_per_scene) == (4, 5, (2, 3))
    assert a.condition == Condition(noise=2, elevation=(12, 20))
    assert b.scenes == 25


def test_every_kind_of_value_is_read(tmp_path: Path) -> None:
    text = "text: t\ndefaults:\nrows:\n  - {name: a, condition: {friction: 0.6, noise: 2}, workspace: [1, 0.5]}\n"
    (row,) = read_experiment(written(tmp_path, text), {}).rows
    assert (row.condition.friction, row.condition.noise, row.workspace) == (0.6, 2, (1, 0.5))


def test_a_file_can_add_rows_to_an_experiment(tmp_path: Path) -> None:
    text = "extends: robustness\ndefaults: {scenes: 2}\nrows:\n  - {name: mine, objects: my_meshes}\n"
    experiment = read_experiment(written(tmp_path, text), {}, only=["holes", "mine"])
    assert [row.name for row in experiment.rows] == ["holes", "mine"]
    assert {(row.seed, row.scenes) for row in experiment.rows} == {(200, 2)}
    assert (experiment.name, experiment.mark) == ("mine", "mine")
    published = read_experiment("paper", {}).mark
    assert read_experiment(written(tmp_path, "extends: paper\n"), {}).mark == "mine" != published, (
        "its table stays"
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("text: t\nrows: [{name: a, propsers: [dgs_net]}]", "row 1: no key 'propsers'; there are name, text"),
        ("text: t\nrows: [{name: a, condition: {noize: 2}}]", "condition: no key 'noize'; there are noise"),
        ("text: t\nrows: [{name: a, proposers: dgs_net}]", "proposers is 'dgs_net', it must be of type tuple"),
        ("text: t\nrows: [{name: a, proposers: [best]}]", "no proposer named 'best'; there are dgs_net, level_pinch"),
        ("text: t\nrows: [{name: a, proposers: []}]", "no proposer is named"),
        ("text: t\nrows: [{name: a, without: [luck]}]", "no stage named 'luck'; there are contact, check, rank"),
        ("text: t\nrows: [{name: a, ablate: score}]", "no ablation named 'score'; there are none, pre_grasp, offset"),
        ("text: t\nrows: [{name: a, rehearse: true}]", "goes with --arm"),
        ("text: t\nrows: [{name: a, condition: {spoil: rain}}]", "no spoil named 'rain'; there are holes"),
        ("text: t\nrows: [{name: a, scenes: 0}]", "0 scenes"),
        ("text: t\nrows: [{text: a}]", "row 1: the key 'name' is missing"),
        ("rows: [{name: a}]", "the key 'text' is missing"),
        ("text: t\nrow: []", "no key 'row'"),
        ("text: [", "no YAML"),
        ("text: t\nrows: [{name: a, condition: worn}]", "condition is 'worn', it must hold keys"),
        ("text: t\nrows: [{name: a, condition: {distance: [1.0]}}]", "distance is .1.0,., it must be of type tuple"),
        ("text: t\nrows: [{name: a, objects_per_scene: [a, 6]}]", "objects_per_scene is"),
        ("text: t\nrows: [{name: a, workspace: [0.4]}]", "workspace is"),
        ("text: t\nrows: [{name: a, scenes: true}]", "scenes is True, it must be of type int"),
        ("text: t\nrows: [a]", "row 1 is 'a', it must hold keys"),
        ("text: t\nrows: [{name: a}, {name: b}, {name: a, seed: 1}]", "several rows are named 'a'"),
        ("text: t\nrows: {name: a}", "rows are a list"),
        ("text: t\nextends: luck", "no experiment named 'luck'"),
        ("text: t\nextends: [robustness]", "extends is .'robustness'., it must name an experiment"),
        ("text: t\nrows:\n", "mine.yaml: it has no rows"),
        ("nothing", "holds no keys"),
    ],
)  # fmt: skip
def test_mistakes_are_refused_with_the_valid_names(text: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=said):
        read_experiment(written(tmp_path, text), {})


def test_files_that_extend_one_another_are_refused(tmp_path: Path) -> None:
    mine = written(tmp_path, f"text: t\nextends: {tmp_path}/other.yaml")
    (tmp_path / "other.yaml").write_text(f"text: t\nextends: {mine}")
    with pytest.raises(ValueError, match=r"mine\.yaml extends itself"):
        read_experiment(mine, {})


def test_every_row_is_run_with_every_file_of_weights() -> None:
    rows = read_experiment("growth", {}, ("a/early", "b/late.pt")).rows
    assert [(row.text, row.weights) for row in rows] == [
        ("alone, a/early", "a/early"),
        ("alone, b/late", "b/late.pt"),
        ("in the planner, a/early", "a/early"),
        ("in the planner, b/late", "b/late.pt"),
    ]
    assert rows[1].model == "late" and rows[1].models_dir == Path("b")
    assert len({row.name for row in rows}) == 4
    unnamed = read_experiment("table2", {}, ("a/early",)).rows
    assert [row.text for row in unnamed] == [
        f"{name}, a/early" for name in ("network", "without_pre_grasp", "without_offset")
    ], "rows of one table are told apart"
    with pytest.raises(ValueError, match="several rows are named 'b_latest_alone'"):  # of one folder, that is
        read_experiment("growth", {}, ("a/b/latest", "c/b/latest"))


def test_the_table_has_an_edge_where_a_proposer_needs_one() -> None:
    plain, pushing = (
        Row("a", proposers=("dgs_net",)),
        Row("b", proposers=("dgs_net", "edge_pinch", "push"), workspace=(0.6, 0.6)),
    )
    assert plain.setting.edge is None
    assert pushing.setting.edge == pytest.approx(-0.35)
    assert pushing.setting.seen[0] > plain.setting.seen[0] + 0.1
    planner = planner_of(replace(pushing, proposers=("push",)), lambda: ([], []))
    assert planner.proposers[0].settings.free == pytest.approx((-0.35, 0.35)), "as wide as the workspace"
