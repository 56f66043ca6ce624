"""The report page, from made-up runs."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgs_description.frames import transform
from dgs_learning.evaluation.protocol import NO_GRASP, AttemptRecord, Item, SceneResult
from dgs_learning.evaluation.records import failure_file, save_scene
from dgs_learning.evaluation.report.page import load_run, write_report
from dgs_learning.evaluation.report.pictures import as_jpeg, draw_attempt, draw_failure
from dgs_learning.evaluation.run import finish
from dgs_learning.evaluation.scene_world import Attempt, Moment, Outcome
from dgs_learning.objects import shapes
from dgs_sim_bridge.render.object_model import from_parts

OUTCOMES = ("success", "slipped", "success", "missed", NO_GRASP, "success", "pushed")


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
    finish(folder, SETTING, 1)
    return folder


SETTING = {
    "proposers": ["dgs_net", "level_pinch"],
    "stages": ["contact", "check", "rank"],
    "model": "dgs_net",
    "model_sha256": "aa",
    "objects": {"name": "novel", "objects": 70, "sha256": "ff"},
    "scenes": 1,
    "objects_per_scene": [4, 6],
    "area": [0.4, 0.8],
    "seed": 7,
    "ablate": "none",
}


def decoded(uri: str) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(base64.b64decode(uri.split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
    return image[..., ::-1]


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
    assert len(page.sources) == 10  # four plots, six attempts
    assert all(s.startswith("data:image/") for s in page.sources)
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
        "(6 of 6 attempts and looks without a grasp)",
    ):
        assert expected in words
    shots = re.findall(r'<div class="shot( good)?">', text)
    assert shots == ["", "", "", " good", " good", " good"]


def test_a_run_from_whose_table_everything_rolled_away_has_a_page(tmp_path: Path) -> None:
    save_scene(tmp_path, SceneResult(0, 0, 0, ()), "1", [])
    finish(tmp_path, SETTING, 1)
    assert "(0 of 0 attempts and" in write_report([tmp_path], tmp_path / "r.html").read_text()


def test_the_gallery_has_room_for_every_kind_of_failure(run_folder: Path) -> None:
    drawn = load_run(run_folder).gallery(4)
    assert [a.outcome for a in drawn] == ["missed", "slipped", NO_GRASP, "success"]


def test_a_picture_shows_hand_and_cloud() -> None:
    cloud = np.random.default_rng(0).uniform((-0.05, -0.05, 0), (0.05, 0.05, 0.08), (50, 3))
    good, bad, none = (
        decoded(draw_attempt(attempt(k, o), cloud))
        for k, o in ((0, "success"), (1, "slipped"), (2, NO_GRASP))
    )
    green_over_red = good[..., 1].astype(int) - good[..., 0]
    assert (green_over_red > 60).mean() > 0.02, "a hand in teal"
    assert (bad[..., 0].astype(int) - bad[..., 2] > 60).mean() > 0.02, "a hand in red"
    coloured = np.ptp(none.astype(int), axis=-1) > 30
    assert 0 < coloured.mean() < 0.05, "points and no hand"


def test_objects_are_listed_by_loss_with_the_first_pictures_of_their_own_failures(tmp_path: Path) -> None:
    names = ("easy", "hard", "late")
    tried = [
        (0, "success"),
        (2, "slipped"),
        (1, "missed"),
        (1, "slipped"),
        (1, "slipped"),
        (1, "slipped"),
        (2, "success"),
    ]
    attempts = tuple(
        replace(attempt(k, outcome), object_name=names[item], item=item)
        for k, (item, outcome) in enumerate(tried)
    )
    items = tuple(Item(name, "bowl", "wide", name != "hard") for name in names)
    save_scene(tmp_path, SceneResult(0, 3, 2, attempts, items), "1", [np.zeros((0, 3))] * len(attempts))
    for a in attempts:
        file = failure_file(tmp_path, 0, a.attempt)
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(as_jpeg(np.full((8, 16, 3), 20 * a.attempt, np.uint8)))
    finish(tmp_path, SETTING, 1)
    (hard, hard_pictures), (late, late_pictures) = load_run(tmp_path).losses()
    assert (hard["object"], hard["left"], late["object"], late["left"]) == ("hard", 1, "late", 0)
    shades = [
        [round(decoded(p).mean() / 20) for p in pictures] for pictures in (hard_pictures, late_pictures)
    ]
    assert shades == [[2, 3, 4], [1]], (
        "three of the four failures of one, the failure but not the success of the other"
    )
    text = write_report([tmp_path], tmp_path / "r.html").read_text()
    lost = text.split("What was lost</h2>")[1].split("<h2>")[0]
    assert lost.count("<img") == 4 and lost.index("hard") < lost.index("late") and "easy" not in lost
    assert "missed 1, slipped 3" in lost


@pytest.mark.parametrize(("outcome", "first"), [(Outcome.SLIPPED, "blue"), (Outcome.APPROACH_CONTACT, "red")])
def test_a_failure_shows_the_hand_closed_and_failed_in_the_order_of_time(
    outcome: Outcome, first: str
) -> None:
    block = from_parts("block", "cuboid", "block", shapes.box([0.05, 0.1, 0.07]), 0.2)
    poses = {0: transform(position=(0, 0, 0.035)), 4: transform(position=(0.12, 0, 0.035))}
    down = transform(np.diag([1.0, -1.0, -1.0]), (0, 0, 0.08))
    up = transform(np.diag([1.0, -1.0, -1.0]), (0, 0, 0.13))
    joints = np.full(20, 0.4)
    failed = Attempt(outcome, 0, Moment(joints, down, poses), Moment(joints, up, poses, moved=4))
    left, right = np.split(draw_failure([block] * 5, failed)[:-24].astype(int), 2, axis=1)
    blue, red = (left, right) if first == "blue" else (right, left)
    assert (blue[..., 2] - blue[..., 0] > 60).mean() > 0.02 and (
        red[..., 2] - red[..., 0] > 60
    ).mean() < 0.002
    assert (red[..., 0] - red[..., 2] > 60).mean() > 0.02
    purple = np.minimum(red[..., 0], red[..., 2]) - red[..., 1] > 30
    assert (purple.mean() > 0.01) == (outcome is Outcome.APPROACH_CONTACT), (
        "what was in the way, if anything was"
    )
    once = draw_failure([block] * 5, replace(failed, outcome=Outcome.MISSED, failed=failed.closed))
    assert once.shape[1] == left.shape[1], "one moment, one picture"
