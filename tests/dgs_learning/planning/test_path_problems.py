"""Problems of MotionBenchMaker's form, with an arm of boxes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from dgs_description.errors import DgsError
from dgs_description.joints import ARM_JOINTS
from dgs_learning.planning.path_problems import ProblemFolder, solve, summarise
from tests.support.commands import dgs

LINK = """
  <link name="{name}">
    <collision><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.04 0.04"/></geometry></collision>
  </link>
  <joint name="{joint}" type="revolute">
    <parent link="{before}"/><child link="{name}"/><origin xyz="{x} 0 0"/><axis xyz="0 {y} {z}"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>"""


def pose(x: float, y: float, z: float) -> dict[str, list[float]]:
    return {"position": [x, y, z], "orientation": [0.0, 0.0, 0.0, 1.0]}


def write_problem(folder: Path, number: int, goal: float, things: list[dict[str, object]]) -> None:
    """Turn the first joint from 0 to `goal` among things."""
    scene = {"world": {"collision_objects": things}}
    joints = [{"joint_name": name, "position": goal if k == 0 else 0.0} for k, name in enumerate(ARM_JOINTS)]
    state = {"name": [*ARM_JOINTS, "finger"], "position": [0.0] * 7}
    request = {
        "start_state": {"joint_state": state},
        "goal_constraints": [{"joint_constraints": joints[::-1]}],
    }
    (folder / f"scene{number:04d}.yaml").write_text(yaml.dump(scene))
    (folder / f"request{number:04d}.yaml").write_text(yaml.dump(request))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    before, links = "base", []
    for k, joint in enumerate(ARM_JOINTS):
        y, z = (0, 1) if k == 0 else (1, 0)
        links.append(
            LINK.format(name=f"link{k}", joint=joint, before=before, x=0.0 if k == 0 else 0.32, y=y, z=z)
        )
        before = f"link{k}"
    (tmp_path / "ur5.urdf").write_text(f'<robot name="a"><link name="base"/>{"".join(links)}</robot>')
    (tmp_path / "ur5.srdf").write_text('<robot name="a"/>')
    here = tmp_path / "problems" / "post_ur5"
    here.mkdir(parents=True)
    post = {
        "primitives": [{"type": "cylinder", "dimensions": [0.4, 0.05]}],
        "primitive_poses": [pose(0, 0, 0)],
    }
    post["pose"] = pose(0.6, 0.6, 0.0)  # type: ignore[assignment]
    ball = {"primitives": [{"type": "sphere", "dimensions": [0.2]}], "primitive_poses": [pose(0, 1, 0)]}
    write_problem(here, 1, 1.5, [])
    write_problem(here, 2, 1.5, [post])
    write_problem(here, 3, np.pi / 2, [ball])
    return tmp_path


def test_a_free_line_a_way_around_and_what_cannot_be(folder: Path) -> None:
    problems = ProblemFolder(folder)
    assert problems.scenes == ("post",)
    free, around, blocked = (solve(problem, 5.0) for problem in problems.problems("post", 5))
    assert free["ours"]["solved"] and free["ours"]["length_rad"] == pytest.approx(1.5)
    assert around["ours"]["solved"] and around["ours"]["length_rad"] > 1.6, "over the post, not through it"
    assert around["rrt_connect"]["found"], (
        "its own coarse steps may graze the post, so it need not count as solved"
    )
    assert free["possible"] and around["possible"] and not blocked["possible"]
    assert not blocked["ours"]["found"] and not blocked["rrt_connect"]["found"]
    row, everything = summarise([free, around, blocked])
    assert row["problems"] == 3 and row["possible"] == 2 and row["ours"]["solved"] == 2
    assert {**row, "scene": "all"} == everything
    assert [problem.number for problem in problems.problems("post", 2)] == [1, 2]


def test_the_command_writes_what_it_measured(folder: Path) -> None:
    out = folder / "paths.json"
    answer = dgs(["bench-paths", str(folder), "--timeout", "2", "--json", str(out)])
    assert "| post | 3 | 2 |" in answer.output
    assert json.loads(out.read_text())["rows"][-1]["ours"]["solved"] == 2


def test_a_folder_without_problems_is_refused(folder: Path) -> None:
    problems = folder / "problems"
    problems.rename(folder / "packed")
    problems.mkdir()
    (folder / "packed").rename(problems / "problems")  # unpacked one folder too deep
    assert "no problems" in dgs(["bench-paths", str(folder)], code=2).output
    (folder / "ur5.srdf").unlink()
    with pytest.raises(DgsError, match=r"no ur5\.srdf"):
        ProblemFolder(folder)
