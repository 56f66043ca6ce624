"""Every command in README and site is read by what would run it: names, options, values, parameters, messages."""

from __future__ import annotations

import functools
import re
import shlex
import subprocess
from collections.abc import Callable, Sequence
from importlib import import_module

import pytest
import rclpy
import yaml
from rclpy.context import Context
from rclpy.node import Node

from dgs_bringup.nodes import NODES, who_offers
from dgs_ros.base_node import DgsNode
from tests.support.commands import read_dgs
from tests.support.environment import GUARD, REPO_ROOT, ros_environment

PAGES = [
    REPO_ROOT / "README.md",
    *sorted(REPO_ROOT.glob("docs/*.md")),
    *sorted(REPO_ROOT.glob("models/**/*.md")),
]


def commands_of(text: str) -> set[str]:
    """The lines of its blocks that are commands, and the commands inside of its sentences."""
    text = text.replace("\\|", "|")
    blocks = re.findall(r"^ *```\w*\n(.*?)```", text, re.DOTALL | re.MULTILINE)
    lines = [line.strip() for block in blocks for line in re.sub(r"\\\n|(?<=,)\n +", "", block).splitlines()]
    found = {part for line in lines for part in re.split(r" && |; (?:do )?|; done", line)}
    found |= set(re.findall(r"`([a-z0-9]+ [^`\n]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL)))
    return {command for command in found if command.split(" ")[0] in READERS}


@functools.cache
def printed(*command: str) -> str:
    """What a command prints; it must end well."""
    done = subprocess.run(
        command,
        cwd=REPO_ROOT,
        env=ros_environment(),
        capture_output=True,
        text=True,
        timeout=GUARD,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def knows(help_text: str, words: Sequence[str]) -> None:
    options = {word for word in words if re.fullmatch(r"--[a-z][a-z-]*", word)}
    assert options <= set(re.findall(r"--[a-z][a-z-]*", help_text)), options


def read_bash(script: str, *words: str) -> None:
    knows(printed("bash", script, "--help"), words)


def read_source(script: str) -> None:
    printed("bash", "-c", f"source {script}")


def read_make(*words: str) -> None:
    printed("make", "-n", *words)


def read_python(m: str, module: str, *words: str) -> None:
    assert m == "-m"
    knows(printed("python", "-m", module, "--help"), words)


def read_ros2(verb: str, *words: str) -> None:
    if verb in ("security", "bag", "param", "topic"):
        pytest.skip("a tool of ROS's own")
    {"run": read_run, "launch": read_launch, "lifecycle": read_lifecycle}.get(verb, read_call)(*words)


def read_run(package: str = "", executable: str = "", *words: str) -> None:
    if not package:
        return
    assert f"{package} {executable}" in printed("ros2", "pkg", "executables", package)
    if "--ros-args" not in words:
        if words:
            knows(printed("ros2", "run", package, executable, "--help"), words)
        return
    (info,) = [info for info in NODES if (info.package, info.name) == (package, executable)]
    given = re.sub(r"--params-file my_\S+", "", " ".join(words)).split()  # a file that the reader writes
    context = Context()
    rclpy.init(args=given, context=context)
    try:
        node = Node(executable, context=context)
        DgsNode._read_parameters(node, info.parameter_class())  # type: ignore[arg-type]
    finally:
        rclpy.shutdown(context=context)


def read_launch(package: str, file: str, *words: str) -> None:
    if package in ("ur_robot_driver", "ur_calibration", "realsense2_camera"):
        pytest.skip("a driver of the hardware")
    assert (REPO_ROOT / "ros2_ws/src" / package / "launch" / file).is_file()
    declared = (REPO_ROOT / "ros2_ws/src" / package / "launch" / file).read_text()
    for word in words:
        name, _, _ = word.partition(":=")
        assert f'("{name}", ' in declared, word


def read_lifecycle(verb: str, node: str, transition: str) -> None:
    assert verb == "set" and transition in ("configure", "activate", "deactivate")
    assert node.strip("/") in {info.name for info in NODES}


def read_call(verb: str, *words: str) -> None:
    """ros2 action send_goal, ros2 service call"""
    assert verb in ("send_goal", "call")
    name, kind, *message = [word for word in words if not word.startswith("--")]
    assert who_offers(name) != "?"
    package, folder, of_kind = kind.split("/")
    interface = getattr(import_module(f"{package}.{folder}"), of_kind)
    values = yaml.safe_load(message[0]) if message else {}
    (interface.Goal if folder == "action" else interface.Request)(**values)


READERS: dict[str, Callable[..., None]] = {
    "bash": read_bash,
    "dgs": read_dgs,
    "make": read_make,
    "python": read_python,
    "ros2": read_ros2,
    "source": read_source,
}
COMMANDS = sorted({(page.name, command) for page in PAGES for command in commands_of(page.read_text())})


@pytest.mark.parametrize(("page", "command"), COMMANDS)
def test_a_command_is_understood(page: str, command: str) -> None:
    command = re.sub(r"\[(-[^]]*)\]|\.\.\.", r"\1", command)  # what may be left out is read, too
    words = [re.sub(r"\|.*", "", word) for word in shlex.split(command, comments=True)]
    READERS[words[0]](*words[1:])


@pytest.mark.parametrize(
    ("command", "why"),
    [
        ("dgs evaluate --scenes few", "valid integer"),
        ("make dinner", "No rule to make target"),
        ("python -m dgs_bringup.suite_file --read", "--read"),
        ("ros2 run dgs_perception camera_node --ros-args -p rate:=high", "unknown parameter 'rate'"),
        ("ros2 action send_goal /clear_table dgs_interfaces/action/ClearTable '{speed: 1}'", "speed"),
    ],
)
def test_a_wrong_command_is_refused(command: str, why: str) -> None:
    with pytest.raises((Exception, SystemExit)) as refusal:
        READERS[command.split()[0]](*shlex.split(command)[1:])
    assert why in str(refusal.value)
