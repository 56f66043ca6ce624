"""What a run's recorder keeps."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dgs_bringup import run_recorder
from dgs_bringup.run_recorder import FRAME_PERIOD, MOST_FRAMES, RunRecorder
from dgs_ros.image_msgs import numpy_to_image


def test_a_long_run_keeps_frames_of_all_of_it_and_not_more_than_it_may(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now = 0.0
    monkeypatch.setattr(run_recorder, "time", SimpleNamespace(monotonic=lambda: now))
    monkeypatch.setattr(run_recorder, "caption", lambda _, label: label)
    recorder = RunRecorder(SimpleNamespace(create_subscription=lambda *_: None))  # type: ignore[arg-type]
    recorder.filming = True
    picture = numpy_to_image(np.zeros((2, 4, 3), np.uint8), "eye")
    for k in range(3 * MOST_FRAMES):
        now, recorder.label = k * FRAME_PERIOD, str(k)
        recorder._on_image(picture)
    kept = [int(frame) for frame in recorder.frames]  # type: ignore[call-overload]
    assert MOST_FRAMES / 2 <= len(kept) <= MOST_FRAMES
    assert kept[0] == 0 and kept[-1] >= 3 * MOST_FRAMES - 4 and set(np.diff(kept)) == {4}
