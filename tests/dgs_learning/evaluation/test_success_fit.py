"""Fitting the ranking: it finds what made grasps hold, is judged on scenes it has not seen, and survives its files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_description.arrays import save_arrays
from dgs_description.errors import ErrorCode
from dgs_description.grasp import GraspSet
from dgs_grasp_planner.planner import GraspPlanner
from dgs_grasp_planner.propose.level_pinch import LevelPinch
from dgs_grasp_planner.success import EVIDENCE, SuccessModel
from dgs_learning.evaluation.success_fit import area_under_curve, fit_success, judge
from dgs_learning.evaluation.trials import Trials, load_trials, run_trials, try_scene
from dgs_learning.objects import shapes
from dgs_learning.parallel import Engine
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts, save_catalogue
from tests.support.commands import dgs
from tests.support.refused import refused


def made_up(count: int = 1500, seed: int = 0) -> Trials:
    """What holds is decided by the first column, and less often with worn hardware."""
    rng = np.random.default_rng(seed)
    values, worn = rng.normal(3.0, 2.0, (count, len(EVIDENCE))), rng.random(count) < 0.5
    logit = 1.5 * (values[:, 0] - 3.0) / 2.0 - 1.5 * worn + 0.5
    held = rng.random(count) < 1 / (1 + np.exp(-logit))
    return Trials(values, held, worn, rng.random(count) < 0.5, np.arange(count) // 10)


def rod(name: str) -> ObjectModel:
    return from_parts(name, "stick", "rod", shapes.lathe([(0.012, -0.07), (0.012, 0.07)], sectors=14), 0.1)


def test_it_finds_what_decides_and_answers_for_new_hardware() -> None:
    fitted = fit_success(made_up())
    rows = np.array([fitted["evidence"][name] for name in EVIDENCE])
    assert rows[0, 2] == pytest.approx(1.5, abs=0.3) and np.abs(rows[1:, 2:]).max() < 0.3
    model = SuccessModel(*rows.T, fitted["bias"])
    typical = model(np.full((1, len(EVIDENCE)), 3.0))[0]
    assert typical == pytest.approx(1 / (1 + np.exp(-0.5)), abs=0.12), (
        "as new, not the mean over worn hardware"
    )


def test_it_is_judged_on_scenes_that_it_has_not_seen() -> None:
    judged = judge(made_up())
    assert judged["trials"] == 1500 and judged["scenes"] == 150
    assert 0.75 < judged["auc"]["all"] < 0.95
    said, held = np.array(judged["reliability"])[:, 1:].T
    assert np.abs(said - held).max() < 0.2
    trials = made_up()
    chance = np.random.default_rng(1).permutation(trials.held)
    blind = judge(Trials(trials.evidence, chance, trials.worn, trials.mujoco, trials.scene))
    assert abs(blind["auc"]["all"] - 0.5) < 0.06
    new = judge(replace(trials, worn=np.zeros_like(trials.worn)))
    assert "worn" in judged["auc"] and set(new["auc"]) == {"all", "new", "mujoco"}, (
        "of no trials nothing is said"
    )


def test_area_under_the_curve() -> None:
    held = np.array([False, True, False, True])
    assert area_under_curve(np.array([0.1, 0.9, 0.2, 0.8]), held) == 1.0
    assert area_under_curve(np.array([0.9, 0.1, 0.8, 0.2]), held) == 0.0
    assert area_under_curve(np.full(4, 0.5), held) == 0.5


def test_trials_go_through_files_and_the_command_writes_a_model(tmp_path: Path) -> None:
    for n, trials in enumerate((made_up(200, 1), made_up(300, 2))):
        folder = tmp_path / str(n)
        folder.mkdir()
        save_arrays(folder / "00000.npz", vars(trials))
    both = load_trials([tmp_path / "0", tmp_path / "1"])
    assert len(both.held) == 500 and len(np.unique(both.scene)) == 50, "scenes of two folders are told apart"
    out = tmp_path / "model.json"
    dgs(["fit-success", str(tmp_path / "0"), "--out", str(out)])
    assert out.exists()
    save_arrays(tmp_path / "0" / "00000.npz", vars(made_up(0)))
    with pytest.raises(ValueError, match="no trials in"):
        load_trials([tmp_path / "0"])


def test_trials_of_other_scenes_are_not_taken_for_those_that_are_wanted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, folder = tmp_path / "objects.npz", tmp_path / "trials"
    save_catalogue(file, [rod("rod")])
    for _ in range(2):
        assert run_trials(str(file), (0, 0), 1, folder, Engine(1)) == 0
    with refused(ErrorCode.REQUEST_INVALID, "seed 1 instead of 2"):
        run_trials(str(file), (0, 0), 2, folder, Engine(1))
    save_catalogue(file, [replace(rod("rod"), mass=0.2)])
    with refused(ErrorCode.REQUEST_INVALID, "objects"):
        run_trials(str(file), (0, 0), 1, folder, Engine(1))
    save_catalogue(file, [rod("rod")])
    own = {"model_sha256": "other", "shape_completion_sha256": ""}
    monkeypatch.setattr("dgs_learning.evaluation.trials.describe_planner", lambda row: own)
    with refused(ErrorCode.REQUEST_INVALID, "model_sha256"):
        run_trials(str(file), (0, 0), 1, folder, Engine(1))


def test_candidates_of_a_scene_are_executed_and_the_same_again() -> None:
    rods, planner = [rod(f"rod{k}") for k in range(4)], GraspPlanner([LevelPinch()])
    one, again = (try_scene(rods, planner, 1, 1) for _ in range(2))
    assert len(one.held) >= 2 and one.held.any() and one.evidence.shape[1] == len(EVIDENCE)
    np.testing.assert_array_equal(one.held, again.held)
    np.testing.assert_array_equal(one.evidence, again.evidence)
    nothing = try_scene(rods, GraspPlanner([lambda scene: GraspSet.empty()]), 1, 0)
    assert not len(nothing.held)
