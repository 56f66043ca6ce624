"""Draws stored grasps from a dataset file and simulates them again: parallel, and resumable to the grasp."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from dgs_learning.dataset import GraspDataset, load_dataset
from dgs_learning.evaluation.metrics import spread, wilson
from dgs_learning.evaluation.provenance import revision, today
from dgs_learning.parallel import Engine
from dgs_learning.validation.checks import Check, StoredGrasp, check_alone, check_in_scene

STAGES = (1, 2)


def draw(total: int, count: int, seed: int, stage: int, among: NDArray[np.bool_] | None = None) -> list[int]:
    """`count` of `total` grasps, or all if there are fewer; a larger count only adds to a smaller one.

    With `among` (total,), only grasps marked there.
    """
    order = np.random.default_rng([seed, stage]).permutation(total)
    return (order if among is None else order[among[order]])[:count].tolist()


def _stage_one(data: GraspDataset, numbers: Sequence[int], seed: int) -> Iterator[tuple[Any, ...]]:
    for number in numbers:
        k = int(np.searchsorted(data.first, number, side="right")) - 1
        grasp = StoredGrasp(
            data.position[number], data.rotation[number], data.joints[number], data.active[number]
        )
        yield number, data.objects[k], grasp, [seed, 1, number]


def _stage_two(data: GraspDataset, numbers: Sequence[int], seed: int) -> Iterator[tuple[Any, ...]]:
    ends = np.cumsum([len(scene.instance) for scene in data.scenes])
    for number in numbers:
        s = int(np.searchsorted(ends, number, side="right"))
        scene = data.scenes[s]
        row = number - (int(ends[s - 1]) if s else 0)
        table = data.scene_grasps(scene)
        grasp = StoredGrasp(table.position[row], table.rotation[row], table.joints[row], table.active[row])
        models = [data.objects[k] for k in scene.objects]
        yield number, s, models, scene.T_table_object, int(table.instance[row]), grasp


def total_grasps(data: GraspDataset, stage: int) -> int:
    """Grasps of a stage in the file."""
    return len(data.position) if stage == 1 else sum(len(scene.instance) for scene in data.scenes)


def of_kind(
    data: GraspDataset, stage: int, classes: Sequence[str], fingers: Sequence[int]
) -> NDArray[np.bool_]:
    """Which grasps of a stage are on an object of one of these shape classes or use so many fingers.

    Nothing given for either means every grasp.
    """
    classed = np.repeat([model.shape_class in classes for model in data.objects], np.diff(data.first))
    mark = (
        classed | np.isin(data.fingers, fingers)
        if len(classes) or len(fingers)
        else np.ones(len(classed), bool)
    )
    if stage == 1:
        return mark
    rows = [data.first[scene.objects[scene.instance]] + scene.grasp for scene in data.scenes]
    return mark[np.concatenate(rows)] if rows else np.zeros(0, bool)


def validate(
    file: Path,
    stage: int,
    count: int,
    seed: int,
    engine: Engine,
    folder: Path,
    classes: Sequence[str] = (),
    fingers: Sequence[int] = (),
) -> dict[str, Any]:
    """Simulate `count` grasps of a dataset file again.

    Args:
        file: the dataset.
        stage: 1 (single objects) or 2 (scenes).
        count: grasps drawn without repetition.
        seed: decides which, and the poses they are tried in.
        classes, fingers: draw among grasps of these shape classes or numbers of fingers only; nothing = among all.
        engine: where the work runs.
        folder: finished checks are kept in a file here; the same call again goes on.

    Raises:
        ValueError: no such stage.
    """
    if stage not in STAGES:
        raise ValueError(f"there is no stage {stage}, only {' and '.join(map(str, STAGES))}")
    data = load_dataset(file)
    digest = hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    numbers = draw(total_grasps(data, stage), count, seed, stage, of_kind(data, stage, classes, fingers))
    journal = folder / f"stage{stage}_seed{seed}_{digest}.jsonl"
    known = read_journal(journal)
    todo = [n for n in numbers if n not in known]
    function: Callable[..., Check] = check_alone if stage == 1 else check_in_scene
    jobs = (_stage_one if stage == 1 else _stage_two)(data, todo, seed)
    folder.mkdir(parents=True, exist_ok=True)
    with (
        journal.open("a") as file_,
        tqdm(
            total=len(numbers), initial=len(numbers) - len(todo), unit="grasp", desc=f"stage {stage}"
        ) as bar,
    ):
        for check in engine.run(function, jobs):
            known[check.number] = check
            # One write per line: a kill may cut the last line, which is then made again.
            file_.write(json.dumps(asdict(check)) + "\n")
            file_.flush()
            bar.update()
            bar.set_postfix(passed=sum(known[n].passed for n in numbers if n in known))
    about = {"stage": stage, "seed": seed, "dataset": file.name, "dataset_sha256": digest}
    if classes or fingers:
        about |= {"classes": list(classes), "fingers": list(fingers)}
    checks = [known[n] for n in numbers]
    failed = sorted(check.number for check in checks if not check.passed)
    return {**about, "revision": revision(), "date": today(), **summarise(checks), "failed": failed}


def read_journal(path: Path) -> dict[int, Check]:
    """Finished checks by grasp; a last line that was cut by a kill is taken off the file."""
    if not path.exists():
        return {}
    lines = path.read_bytes().split(b"\n")
    if lines[-1]:
        path.write_bytes(b"".join(line + b"\n" for line in lines[:-1]))
    checks = (Check(**json.loads(line)) for line in lines[:-1])
    return {check.number: check for check in checks}


def _share(checks: Sequence[Check]) -> dict[str, Any]:
    passed = sum(c.passed for c in checks)
    return {"tried": len(checks), "passed": passed, "share": passed / max(1, len(checks))}


def summarise(checks: Sequence[Check]) -> dict[str, Any]:
    """Counts in all, per class and per number of fingers; how the rest ended; penetration [mm]."""
    ends = [c.how for c in checks]
    return {
        **_share(checks),
        "interval": wilson(sum(c.passed for c in checks), len(checks)),
        "penetration_mm": {
            **spread([c.penetration_mm for c in checks]),
            "max": max((c.penetration_mm for c in checks), default=0.0),
        },
        "ends": {how: ends.count(how) for how in sorted(set(ends))},
        "by_class": {
            name: _share([c for c in checks if c.shape_class == name])
            for name in sorted({c.shape_class for c in checks})
        },
        "by_fingers": {
            str(n): _share([c for c in checks if c.fingers == n]) for n in sorted({c.fingers for c in checks})
        },
    }


def table(summary: dict[str, Any]) -> str:
    """A few readable lines."""
    low, high = np.array(summary["interval"]) * 100
    depth = summary["penetration_mm"]
    lines = [
        f"stage {summary['stage']}: {summary['passed']} of {summary['tried']} passed, "
        f"{summary['share'] * 100:.1f} % [{low:.1f}, {high:.1f}]"
    ]
    if summary["tried"]:
        lines.append(
            f"penetration of the stored hand: mean {depth['mean']:.2f} mm, p95 {depth['p95']:.2f} mm, "
            f"max {depth['max']:.2f} mm"
        )
    for group in ("by_class", "by_fingers"):
        for name, row in summary[group].items():
            label = name if group == "by_class" else f"{name} fingers"
            lines.append(
                f"  {label:10s} {row['passed']:4d} of {row['tried']:4d}  {row['share'] * 100:5.1f} %"
            )
    lines.append("  ends: " + ", ".join(f"{how} {n}" for how, n in summary["ends"].items()))
    return "\n".join(lines)
