"""What ran beside what, of a demo run."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from PIL import Image

from dgs_bringup.timeline import Bar, bars, main, overlap_seconds

RUN = [
    {"time": 0.0, "attempt": 1, "stage": "capture"},
    {"time": 1.0, "attempt": 1, "stage": "predicted"},
    {"time": 1.0, "attempt": 1, "stage": "carry"},
    {"time": 2.0, "attempt": 2, "stage": "capture"},
    {"time": 3.0, "attempt": 1, "stage": "release"},
    {"time": 3.5, "attempt": 2, "stage": "waiting"},
    {"time": 4.0, "attempt": 1, "stage": "recorded"},
    {"time": 4.0, "attempt": 2, "stage": "transfer"},
]


def test_a_stage_lasts_until_the_next_one_of_its_attempt() -> None:
    assert bars(RUN) == [
        Bar(1, "capture", 0.0, 1.0),
        Bar(1, "carry", 1.0, 3.0),
        Bar(2, "capture", 2.0, 3.5),
        Bar(1, "release", 3.0, 4.0),
        Bar(2, "waiting", 3.5, 4.0),
    ]


def test_what_was_decided_after_the_arm_began_to_plan_ends_no_planning() -> None:
    told = [(1.0, "predict"), (1.5, "planning"), (1.6, "predicted"), (2.0, "transfer")]
    timeline = [{"time": time, "attempt": 1, "stage": stage} for time, stage in told]
    assert bars(timeline) == [Bar(1, "predict", 1.0, 1.5), Bar(1, "planning", 1.5, 2.0)]
    timeline[1]["stage"], timeline[2]["stage"] = "predicted", "planning"
    assert bars(timeline) == [Bar(1, "predict", 1.0, 1.5), Bar(1, "planning", 1.6, 2.0)]


def test_waiting_is_no_overlap_but_looking_is() -> None:
    much_later = {"time": 9.0, "attempt": 2, "stage": "approach"}
    assert overlap_seconds(bars([*RUN, much_later])) == pytest.approx(1.5)
    assert overlap_seconds([bar for bar in bars(RUN) if bar.attempt == 1]) == 0.0


def test_the_picture_shows_bars(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text(json.dumps({"timeline": RUN}))
    main(tmp_path / "summary.json", tmp_path / "picture.png", first=1, count=2)
    picture = np.asarray(Image.open(tmp_path / "picture.png").convert("RGB"))
    with pytest.raises(typer.BadParameter, match="no attempts 7 to 8"):
        main(tmp_path / "summary.json", tmp_path / "picture.png", first=7, count=2)
    for colour in ((0x48, 0x78, 0xA8), (0xE0, 0xA0, 0x40)):
        assert (np.abs(picture.astype(int) - colour).max(axis=-1) < 4).sum() > 500


@pytest.mark.parametrize("text", [None, "{", "[]", "{}", '{"timeline": [{"time": 1.0}]}', "\0\xff"])
def test_a_file_that_is_no_summary_of_a_demo_is_refused(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / "summary.json").write_text(text, encoding="latin-1")
    with pytest.raises(typer.BadParameter, match="no summary"):
        main(tmp_path / "summary.json", tmp_path / "picture.png")


@pytest.mark.parametrize("name", ["none/picture.png", "picture.what"])
def test_a_picture_that_cannot_be_written_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "summary.json").write_text(json.dumps({"timeline": RUN}))
    with pytest.raises(typer.BadParameter, match="no picture can be written"):
        main(tmp_path / "summary.json", tmp_path / name)
