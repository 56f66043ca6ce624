"""The report page and the README's block, from made-up runs."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from dgs_learning.cli.app import app
from dgs_learning.evaluation.drawing import draw_attempt
from dgs_learning.evaluation.protocol import NO_GRASP, AttemptRecord, SceneResult
from dgs_learning.evaluation.readme import fill_readme, load_published, publish
from dgs_learning.evaluation.records import save_scene
from dgs_learning.evaluation.report import load_run, write_report
from dgs_learning.evaluation.run import write_summary

OUTCOMES = ("success", "slipped", "success", "missed", NO_GRASP, "success")


def attempt(k: int, outcome: str) -> AttemptRecord:
    if outcome == NO_GRASP:
        return AttemptRecord(0, k, rejected={"FINGERS_IN_CLOUD": 4})
    rng = np.random.default_rng(k)
    return AttemptRecord(
        scene=0,
        attempt=k,
        object_name=f"thing_{k} <&>",
        shape_class="bowl" if k % 2 else "stick",
        outcome=outcome,
        score=0.9 - 0.1 * k,
        seconds=0.3,
        stage_times={"network": 0.2, "total": 0.3},
        position=(0.01, 0.02, 0.06),
        rotation=tuple(Rotation.from_euler("x", np.pi + 0.1 * k).as_matrix().ravel()),
        pre_grasp=tuple(rng.uniform(0, 0.3, 20)),
        grasp=tuple(rng.uniform(0, 0.8, 20)),
        pd_mm=0.5 * k,
        pv_mm3=100.0 * k,
    )


@pytest.fixture
def run_folder(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    cloud = np.random.default_rng(0).uniform((-0.1, -0.1, 0), (0.1, 0.1, 0.08), (400, 3))
    attempts = tuple(attempt(k, outcome) for k, outcome in enumerate(OUTCOMES))
    save_scene(folder, SceneResult(0, 4, 3, attempts), "1234567890", [cloud] * len(attempts))
    described = {
        "planner": "dgs_net",
        "model": "dgs_net",
        "model_sha256": "aa",
        "objects": {"name": "novel", "objects": 70, "sha256": "ff"},
        "scenes": 1,
        "objects_per_scene": [4, 6],
        "area": [0.4, 0.8],
        "seed": 7,
        "ablate": "none",
    }
    write_summary(folder, described, 1)
    return folder


class Page(HTMLParser):
    """Collects tags' sources and checks that every tag is closed."""

    VOID = {"meta", "br", "img", "path", "polygon", "link"}

    def __init__(self, text: str) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.sources: list[str] = []
        self.words: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]
        if tag not in self.VOID:
            self.stack.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        if tag not in self.VOID:
            assert self.stack.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words.append(data)


def test_the_page_is_self_contained_and_shows_failures_first(run_folder: Path, tmp_path: Path) -> None:
    text = write_report([run_folder], tmp_path / "r.html").read_text()
    page = Page(text)
    assert page.stack == []
    assert not [s for s in page.sources if s.startswith(("http", "/", "file"))]
    assert "<script" not in text
    words = " ".join(" ".join(page.words).split())
    assert "thing_1 <&>" in words  # names are escaped
    for expected in (
        "74.81",
        "84.73",
        "0.375",
        "35.18",
        "4-6 objects (novel) in 0.4 x 0.8 m",
        "1234567890",
        "fingers in cloud: 4",
    ):
        assert expected in words
    shots = re.findall(r'<div class="shot( good)?">', text)
    assert shots == ["", "", "", " good", " good", " good"]


def test_the_gallery_has_room_for_every_kind_of_failure(run_folder: Path) -> None:
    drawn = load_run(run_folder).gallery(4)
    assert [a.outcome for a in drawn] == ["missed", "slipped", NO_GRASP, "success"]


def test_a_drawing_shows_hand_and_cloud() -> None:
    cloud = np.random.default_rng(0).uniform((-0.05, -0.05, 0), (0.05, 0.05, 0.08), (50, 3))
    good, bad, none = (
        draw_attempt(attempt(k, o), cloud) for k, o in ((0, "success"), (1, "slipped"), (2, NO_GRASP))
    )
    assert good.count("<polygon") == 6  # boxes of the palm
    assert good.count('stroke="#0f8b8d"') == 15  # phalanges of the final shape
    assert '"#c8553d"' in bad
    assert none.count("h.1") == 50
    assert "<polygon" not in none


def test_an_unfinished_run_is_refused(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["report", str(tmp_path), "--out", str(tmp_path / "r.html")])
    assert result.exit_code == 2
    assert "no finished run" in " ".join(result.output.replace("│", " ").split())


def test_the_readme_is_filled_from_published_summaries(run_folder: Path, tmp_path: Path) -> None:
    (published,) = publish([run_folder], tmp_path / "results")
    assert published.name == "dgs_net_novel_4-6_seed7.json"
    readme = tmp_path / "README.md"
    readme.write_text("before\n<!-- results:start -->\nold\n<!-- results:end -->\nafter\n")
    assert fill_readme(readme, tmp_path / "results")
    text = readme.read_text()
    assert text.startswith("before\n")
    assert text.endswith("<!-- results:end -->\nafter\n")
    assert "old" not in text
    row = next(line for line in text.splitlines() if line.startswith("| DGS-Net"))
    assert "60.0 (" in row  # three of five
    assert "75.0" in row  # three of four objects
    assert "seed 7" in text
    assert "`1234567890`" in text
    cells = {line.count("|") for line in text.splitlines() if line.startswith("|")}
    assert cells == {9}
    assert not fill_readme(readme, tmp_path / "results")


def test_the_readme_counts_the_level_pinches_of_the_whole_planner_only(
    run_folder: Path, tmp_path: Path
) -> None:
    summary = json.loads((run_folder / "summary.json").read_text())
    readme = tmp_path / "README.md"
    readme.write_text("<!-- results:start -->\n<!-- results:end -->\n")
    summary["level_pinches"] |= {"attempts": 2, "successes": 1}
    for ablate in ("none", "offset"):
        summary["setting"] |= {"ablate": ablate}
        (tmp_path / "results").mkdir(exist_ok=True)
        (tmp_path / "results" / f"{ablate}.json").write_text(json.dumps(summary))
    fill_readme(readme, tmp_path / "results")
    assert (
        "2 of its 5 attempts were level pinches proposed by geometry (50.0 % succeeded)" in readme.read_text()
    )


def test_published_runs_are_sorted_by_setting_then_planner(run_folder: Path, tmp_path: Path) -> None:
    summary = json.loads((run_folder / "summary.json").read_text())
    for k, (planner, ablate, count) in enumerate(
        [
            ("top_down", "none", [4, 6]),
            ("dgs_net", "offset", [4, 6]),
            ("dgs_net", "none", [10, 10]),
            ("dgs_net", "none", [4, 6]),
        ]
    ):
        summary["setting"] |= {"planner": planner, "ablate": ablate, "objects_per_scene": count}
        (tmp_path / f"{k}.json").write_text(json.dumps(summary))
    order = [(s["setting"]["planner"], s["setting"]["ablate"]) for s in load_published(tmp_path)]
    assert order == [("dgs_net", "none"), ("dgs_net", "offset"), ("top_down", "none"), ("dgs_net", "none")]


def test_a_readme_without_marks_is_refused(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("nothing")
    with pytest.raises(ValueError, match="results:start"):
        fill_readme(tmp_path / "README.md", tmp_path)
