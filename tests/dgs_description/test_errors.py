"""Error codes: one number each, in the range of its node."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from dgs_description.errors import DgsError, ErrorCode

RANGES = {
    "planner": (
        range(100, 200),
        ("CLOUD_", "NO_CLOUD", "NO_OBJECTS", "NO_GRASP", "REQUEST_", "WEIGHTS_", "PLANNER_", "REGION_"),
    ),
    "hand": (range(300, 400), ("HAND_",)),
    "camera": (range(400, 500), ("CAMERA_", "BAG_", "DEPTH_", "EXTRINSICS_INVALID", "CALIBRATION_")),
    "task": (range(500, 600), ("TASK_",)),
    "simulator": (range(600, 700), ("SIM_",)),
}
ELSEWHERE = {ErrorCode.HAND_UNAVAILABLE}  # the arm's word for a hand that does not answer


def test_no_number_is_used_twice() -> None:
    # An IntEnum silently makes the second name of a number an alias of the first.
    assert len(ErrorCode.__members__) == len(set(ErrorCode))


@pytest.mark.parametrize("node", RANGES)
def test_codes_of_a_node_lie_in_its_range(node: str) -> None:
    numbers, prefixes = RANGES[node]
    named = {code for code in ErrorCode if code.name.startswith(prefixes)} - ELSEWHERE
    assert named
    assert {code for code in named if code not in numbers} == set()
    assert {code.name for code in ErrorCode if code in numbers} == {code.name for code in named}


def test_every_code_lies_in_some_range() -> None:
    assert ErrorCode.SUCCESS == 0
    for code in ErrorCode:
        assert code == 0 or 10 <= code < 100 or 100 <= code < 700


def test_exception_carries_code_and_sentence() -> None:
    error = DgsError(ErrorCode.CLOUD_EMPTY, "the cloud has no points")
    assert (error.code, error.message, str(error)) == (
        100,
        "the cloud has no points",
        "the cloud has no points",
    )
    with pytest.raises(ValueError):
        DgsError(99999, "no such code")  # type: ignore[arg-type]


def test_a_name_of_a_megabyte_does_not_come_back_whole() -> None:
    error = DgsError(ErrorCode.CLOUD_FRAME_UNKNOWN, f"frame {10**6 * 'x'} is unknown: use base_link")
    assert error.message.startswith("frame x") and error.message.endswith("is unknown: use base_link")
    assert len(error.message) < 1100


def test_every_code_is_explained() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "error_codes.md").read_text()
    rows = re.findall(r"^\| (\d+) \| (\w+) \| .{4,} \|$", page, flags=re.M)
    assert [(int(code), name) for code, name in rows] == [(int(code), code.name) for code in ErrorCode]
