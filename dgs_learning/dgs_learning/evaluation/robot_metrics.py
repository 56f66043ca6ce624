"""The numbers of the robot protocol (Table V) from finished scenes; what the arm or hand spoiled is counted apart."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from dgs_description.errors import ErrorCode
from dgs_learning.evaluation.metrics import clearance, success

GRASP_FAILURES = ("not lifted", "lost in lift")
"""The grasp was executed as planned and did not work."""
ARM_FAILURES = ("planning failure", "execution abort", "hand fault")
"""Arm or hand did not carry the attempt through."""
AFTER_LIFT = ("lost on the way", "taken for lost", "fault on the way")
"""Attempts that count as successes, and that did not end as they should: whose object did not come into the bin, whose
object the arm's executor took for lost (nearly all lie in the bin), and where arm or hand did not go on."""
UNREACHABLE = "no reachable grasp"
"""The arm could execute no grasp of a look at the table: no attempt, but what stays behind counts against CR."""

_GRASP = {
    ErrorCode.SUCCESS: "not lifted",  # the fingers felt an object, the simulator saw none rise
    ErrorCode.NOTHING_HELD: "not lifted",
    ErrorCode.FORCE_LIMIT: "not lifted",  # the hand met what nobody saw: the free hand's "approach contact"
    ErrorCode.LOST_OBJECT: "lost in lift",
}
_PLANNING = range(ErrorCode.NO_CANDIDATES, ErrorCode.NO_FEASIBLE_GRASP + 1)
_HAND = range(300, 400)
_COUNTED = re.compile(r"(\d+) ([A-Z][A-Z_]+)")


def failure_kind(code: int) -> str:
    """Why an executed grasp that lifted nothing failed, from the code that the arm executor gave."""
    if code in _GRASP:
        return _GRASP[ErrorCode(code)]
    if code in _PLANNING:
        return "planning failure"
    if code in _HAND or code == ErrorCode.HAND_UNAVAILABLE:
        return "hand fault"
    return "execution abort"


def refused_grasps(sentences: Sequence[str]) -> dict[str, int]:
    """How many grasps the arm refused by reason; it says so in words: "none of 9 grasps can be executed: 9 NO_PATH"."""
    counts: Counter[str] = Counter()
    for count, name in (pair for sentence in sentences for pair in _COUNTED.findall(sentence)):
        if name in ErrorCode.__members__:
            counts[name] += int(count)
    return dict(counts.most_common())


def summarise_robot(scenes: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All numbers of finished scenes, from their `summary.json` as `scripts/demo.sh` writes it; rates in [0, 1].

    `sr` counts every executed grasp, `sr_grasp` only those that arm and hand carried through; success is the
    simulator's ground truth (lifted by 0.1 m and held, or in the bin). `time_s`: wall time, and time on the
    simulator's clock, per attempt; `picks_per_hour`: objects brought into the bin in an hour of that.
    """
    attempts = [record for scene in scenes for record in counted(scene)]
    failures = Counter(failure_kind(a["code"]) for a in attempts if not a["success"])
    good = sum(bool(a["success"]) for a in attempts)
    grasps = success(good, len(attempts) - sum(failures[kind] for kind in ARM_FAILURES))
    after = Counter(failure_kind(a["code"]) for a in attempts if a["success"] and a["code"])
    faults = sum(after[kind] for kind in ARM_FAILURES)
    lost = sum(max(0, sum(a["success"] for a in counted(scene)) - scene["cleared"]) for scene in scenes)
    pinches = [bool(a["success"]) for a in attempts if a.get("source") == "level_pinch"]
    refusals = [sentence for scene in scenes for sentence in scene["refusals"]]
    stages = dict.fromkeys(stage for a in attempts for stage in a["seconds"])
    number = max(1, len(attempts))
    simulated = sum(s["simulated_seconds"] for s in scenes)
    return {
        **clearance([(scene["cleared"], scene["objects"]) for scene in scenes]),
        **success(good, len(attempts)),
        "sr_grasp": grasps["sr"],
        "sr_grasp_interval": grasps["sr_interval"],
        "level_pinches": {"attempts": len(pinches), "successes": sum(pinches)},
        "failures": {
            **{kind: failures[kind] for kind in (*GRASP_FAILURES, *ARM_FAILURES)},
            UNREACHABLE: len(refusals),
        },
        "after_lift": dict(zip(AFTER_LIFT, (lost, after.total() - faults, faults), strict=True)),
        "refused_grasps": refused_grasps(refusals),
        "table_force": _table_force(scenes),
        "picks_per_hour": 3600.0 * sum(s["cleared"] for s in scenes) / max(simulated, 1e-9),
        "time_s": {
            "wall": sum(s["seconds"]["total"] for s in scenes) / number,
            "simulated": simulated / number,
            "stages": {name: sum(a["seconds"].get(name, 0.0) for a in attempts) / number for name in stages},
        },
    }


def _table_force(scenes: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Most that the robot pressed on table or bin, by stage [N]; only a rehearsal's scenes tell it."""
    most: dict[str, float] = {}
    for forces in (scene.get("table_force", {}) for scene in scenes):
        most.update({stage: max(force, most.get(stage, 0.0)) for stage, force in forces.items()})
    return most


def counted(scene: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """A scene's attempts without the one that the time limit cut off."""
    return [a for a in scene["records"] if a["code"] != ErrorCode.EXECUTION_CANCELLED]
