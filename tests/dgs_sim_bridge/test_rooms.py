"""Imports go from the node to the world, and from the world to pictures and hand; pictures need no physics."""

from __future__ import annotations

import ast
import subprocess
import sys

import pytest

from tests.support.environment import REPO_ROOT

PACKAGE = REPO_ROOT / "dgs_sim_bridge" / "dgs_sim_bridge"
ALLOWED = {
    "render": {"dgs_description", "dgs_sim_bridge.render"},
    "hand": {"dgs_description", "dgs_hand_driver", "dgs_sim_bridge.hand"},
    "world": {
        "dgs_description",
        "dgs_hand_driver",
        "dgs_sim_bridge.render",
        "dgs_sim_bridge.hand",
        "dgs_sim_bridge.world",
    },
}


@pytest.mark.parametrize("room", ALLOWED)
def test_rooms_import_downwards_only(room: str) -> None:
    for file in (PACKAGE / room).glob("*.py"):
        for statement in ast.walk(ast.parse(file.read_text())):
            if isinstance(statement, ast.ImportFrom) and statement.module.startswith("dgs_"):
                parts = statement.module.split(".")
                assert {parts[0], ".".join(parts[:2])} & ALLOWED[room], f"{file.name}: {statement.module}"


def test_pictures_need_neither_physics_nor_the_hands_driver() -> None:
    modules = [f"dgs_sim_bridge.render.{file.stem}" for file in (PACKAGE / "render").glob("[!_]*.py")]
    code = (
        "import sys; sys.modules.update(pybullet=None, dgs_hand_driver=None, can=None, rclpy=None); "
        f"import {', '.join(modules)}; from dgs_sim_bridge.render.meshes import link_meshes; assert link_meshes()"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(sys.path)})
