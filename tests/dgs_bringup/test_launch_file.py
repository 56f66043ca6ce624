"""The launch file with small stand-ins for `launch` and `launch_ros`, which the wheels do not have."""

from __future__ import annotations

import runpy
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from dgs_bringup.nodes import MODES
from tests.support.environment import REPO_ROOT

pytest.importorskip("ament_index_python", reason="ROS is not on this machine")

LAUNCH_FILE = REPO_ROOT / "ros2_ws/src/dgs_bringup/launch/suite.launch.py"
STAND_INS = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "RegisterEventHandler"),
    "launch.event_handlers": ("OnProcessExit",),
    "launch.substitutions": ("LaunchConfiguration",),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
}


class Noted:
    """Any class of launch: keeps what it was made of."""

    def __init__(self, *given: Any, **named: Any) -> None:
        self.given = given
        self.__dict__.update(named)

    def perform(self, context: Any) -> str:
        """Value of a LaunchConfiguration."""
        return context.launch_configurations[self.given[0]]


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch):
    """What `ros2 launch dgs_bringup suite.launch.py` with these arguments would start."""
    for name, classes in STAND_INS.items():
        module = ModuleType(name)
        module.__dict__.update({each: type(each, (Noted,), {}) for each in classes})
        monkeypatch.setitem(sys.modules, name, module)

    def launch(*words: str, file: str = "suite.launch.py") -> list[Any]:
        monkeypatch.setattr(sys, "argv", ["ros2", "launch", "dgs_bringup", file, *words])
        *declared, function = runpy.run_path(str(LAUNCH_FILE))["generate_launch_description"]().given[0]
        values = {argument.given[0]: argument.default_value for argument in declared}
        values |= dict(word.split(":=") for word in words)
        return function.function(SimpleNamespace(launch_configurations=values, argv=list(words)))

    return launch


@pytest.mark.parametrize("mode", MODES)
def test_the_nodes_of_the_mode_are_started(launched, mode: str) -> None:
    actions = launched(f"mode:={mode}", "bag:=somewhere")
    nodes = [(action.package, action.name) for action in actions if hasattr(action, "executable")]
    assert nodes == [(node.package, node.name) for node in MODES[mode]]


def test_a_node_that_ends_ends_the_others_with_a_sentence_and_an_exit_code(launched) -> None:
    handlers = [action.given[0] for action in launched() if action.given]
    assert len(handlers) == len(MODES["simulation"])
    (hand,) = [handler for handler in handlers if handler.target_action.name == "hand_driver_node"]
    with pytest.raises(RuntimeError, match="hand_driver_node has ended with exit code -9"):
        hand.on_exit(SimpleNamespace(returncode=-9), SimpleNamespace(is_shutdown=False))
    hand.on_exit(SimpleNamespace(returncode=0), SimpleNamespace(is_shutdown=True))


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["mode:=fast"], "none of simulation, robot, replay"),
        (["mode:=replay"], "needs bag:="),
        (["view:=yes"], "neither true nor false"),
    ],
)
def test_wrong_values_are_refused(launched, words: list[str], sentence: str) -> None:
    with pytest.raises(RuntimeError, match=sentence):
        launched(*words)


def test_a_misspelt_argument_is_refused_and_those_of_launch_are_not(launched) -> None:
    with pytest.raises(
        RuntimeError, match=r"parmas:=my\.yaml: there is no argument parmas; there are mode, params"
    ):
        launched("mode:=robot", "parmas:=my.yaml")
    assert launched("sigkill_timeout:=20")


def test_a_launch_file_that_includes_this_one_may_have_arguments_of_its_own(launched) -> None:
    assert launched("robots:=2", file="mine.launch.py")
