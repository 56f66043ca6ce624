"""The workspace: what colcon finds, what it built, and how the executables are started."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.support.environment import GUARD, REPO_ROOT

WORKSPACE = REPO_ROOT / "ros2_ws"
EXECUTABLES = {
    ("dgs_arm_executor", "arm_executor_node"),
    ("dgs_arm_executor", "check_extrinsics"),
    ("dgs_bringup", "clear_table"),
    ("dgs_bringup", "plan_pick"),
    ("dgs_grasp_planner", "grasp_planner_node"),
    ("dgs_hand_driver", "hand_driver_node"),
    ("dgs_perception", "calibrate_hand_eye"),
    ("dgs_perception", "camera_node"),
    ("dgs_perception", "cloud_recorder"),
    ("dgs_bringup", "robot_state"),
    ("dgs_viewer", "viewer_node"),
    ("dgs_sim_bridge", "sim_bridge_node"),
}
PACKAGES = {package for package, _ in EXECUTABLES} | {"dgs_description", "dgs_interfaces", "dgs_ros"}


def run(
    *command: str | Path, env: Mapping[str, str], cwd: Path = REPO_ROOT
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(part) for part in command],
        env=env,
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
        timeout=GUARD,
    )


@pytest.fixture
def bare_env() -> dict[str, str]:
    """What a program has whose user sourced nothing."""
    return {"PATH": "/usr/local/bin:/usr/bin:/bin", "HOME": os.environ["HOME"], "LANG": "C.UTF-8"}


def test_colcon_in_the_workspace_folder_finds_every_package_and_no_other(ros_env):
    listed = run("colcon", "list", "--names-only", env=ros_env, cwd=WORKSPACE)
    assert set(listed.stdout.split()) == PACKAGES, listed.stderr


def test_every_executable_is_in_the_ament_index(ros_env):
    listed = run("ros2", "pkg", "executables", env=ros_env)
    found = {tuple(line.split()) for line in listed.stdout.splitlines() if line.startswith("dgs_")}
    assert found == EXECUTABLES, listed.stderr


def test_setup_files_declare_these_executables_and_their_modules_exist():
    declared = {}
    for setup_file in (WORKSPACE / "src").glob("*/setup.cfg"):
        for line in re.findall(r"^    (\w+ = [\w.]+:\w+)$", setup_file.read_text(), re.MULTILINE):
            name, target = line.split(" = ")
            declared[setup_file.parent.name, name] = setup_file.parent / (
                target.split(":")[0].replace(".", "/") + ".py"
            )
    assert set(declared) == EXECUTABLES
    missing = [str(module.relative_to(REPO_ROOT)) for module in declared.values() if not module.is_file()]
    assert not missing


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_package_is_installed_with_its_manifest(ros_env, package):
    prefix = run("ros2", "pkg", "prefix", package, env=ros_env)
    assert prefix.returncode == 0, prefix.stderr
    manifest = (Path(prefix.stdout.strip()) / "share" / package / "package.xml").read_text()
    assert f"<name>{package}</name>" in manifest
    assert "<license>Apache-2.0</license>" in manifest


@pytest.mark.parametrize("package", sorted(PACKAGES - {"dgs_interfaces"}) + ["dgs_learning"])
def test_python_package_imports_without_ros_from_the_repository_root(bare_env, package):
    # The repository's root is the place where a folder could pass for the package.
    code = f"import {package}; print({package}.__file__)"
    result = run(sys.executable, "-c", code, env=bare_env)
    assert result.returncode == 0, result.stderr
    assert Path(result.stdout.strip()).name == "__init__.py"


def test_edits_take_effect_without_a_build(ros_env):
    code = "import dgs_perception, pathlib; print(pathlib.Path(dgs_perception.__file__).resolve())"
    result = run("python", "-c", code, env=ros_env, cwd=Path("/"))
    assert Path(result.stdout.strip()) == REPO_ROOT / "dgs_perception" / "dgs_perception" / "__init__.py"


def test_bringup_installs_its_data_folders(ros_env):
    prefix = run("ros2", "pkg", "prefix", "dgs_bringup", env=ros_env).stdout.strip()
    share = Path(prefix) / "share" / "dgs_bringup"
    for folder in ("launch", "config", "scripts"):
        in_source = {
            file.name for file in (WORKSPACE / "src" / "dgs_bringup" / folder).glob("*") if file.is_file()
        }
        installed = {file.name for file in (share / folder).glob("*")}
        assert in_source <= installed, f"{folder}: run `make build`"


# --- the environment script


def environment_after(script: str, env: Mapping[str, str], cwd: Path) -> dict[str, str]:
    result = run("bash", "-c", f"{script}\nenv -0", env=env, cwd=cwd)
    assert result.returncode == 0, result.stderr
    return dict(entry.split("=", 1) for entry in result.stdout.split("\0") if "=" in entry)


def test_environment_script_works_from_any_folder_in_strict_mode_and_twice(bare_env, tmp_path):
    source = f"source '{WORKSPACE}/setup_env.sh'"
    once = environment_after(f"set -euo pipefail; {source}", bare_env, tmp_path)
    twice = environment_after(f"set -euo pipefail; {source}; {source}", bare_env, tmp_path)
    ignored = {"_", "PS1"}
    assert {k: v for k, v in once.items() if k not in ignored} == {
        k: v for k, v in twice.items() if k not in ignored
    }
    assert once["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert once["RMW_IMPLEMENTATION"] == "rmw_fastrtps_cpp"
    assert once["OMP_WAIT_POLICY"] == "PASSIVE" and once["OPENBLAS_NUM_THREADS"] == "1"
    assert Path(once["FASTRTPS_DEFAULT_PROFILES_FILE"]).is_file()
    assert str(WORKSPACE / "install" / "dgs_interfaces") in once["AMENT_PREFIX_PATH"].split(":")


def test_environment_script_leaves_the_callers_shell_options_alone(bare_env):
    script = f"set +e +u; source '{WORKSPACE}/setup_env.sh'; [[ $- != *[eu]* ]] || exit 7; false; true"
    assert run("bash", "-c", script, env=bare_env).returncode == 0
    script = f"set -eu; source '{WORKSPACE}/setup_env.sh'; [[ $- == *e* && $- == *u* ]] || exit 7"
    assert run("bash", "-c", script, env=bare_env).returncode == 0


def test_environment_script_keeps_the_users_choices(bare_env, tmp_path):
    own = {
        **bare_env,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "FASTRTPS_DEFAULT_PROFILES_FILE": "/own.xml",
    }
    env = environment_after(f"source '{WORKSPACE}/setup_env.sh'", own, tmp_path)
    assert env["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SUBNET"
    assert env["FASTRTPS_DEFAULT_PROFILES_FILE"] == "/own.xml"


def test_environment_script_without_anything_installed_says_what_to_do(bare_env, tmp_path):
    env = {**bare_env, "DGS_ROS": "wheels", "DGS_VENV": str(tmp_path / "none")}
    result = run("bash", "-c", f"source '{WORKSPACE}/setup_env.sh'", env=env)
    assert result.returncode != 0
    assert "make setup" in result.stderr


def test_environment_script_beside_another_distribution_of_ros_says_so(bare_env, tmp_path):
    (tmp_path / "rclpy").mkdir()
    (tmp_path / "rclpy/__init__.py").write_text("raise ImportError('of another Python')\n")
    other = {"ROS_DISTRO": "humble", "AMENT_PREFIX_PATH": str(tmp_path), "PYTHONPATH": str(tmp_path)}
    script = f"source '{WORKSPACE}/setup_env.sh' && python3 -c 'import rclpy'"
    result = run("bash", "-c", script, env={**bare_env, "DGS_ROS": "wheels", **other})
    assert result.returncode == 1
    assert result.stderr.startswith("setup_env.sh: ROS 2 humble is sourced in this shell")


def test_environment_script_in_another_shell_says_that_it_needs_bash(bare_env):
    result = run("sh", "-c", f"unset BASH_VERSION; . '{WORKSPACE}/setup_env.sh'", env=bare_env)
    assert (result.returncode, result.stderr) == (1, "setup_env.sh needs bash\n")


def test_a_real_ros2_command_goes_before_the_stand_in(bare_env, tmp_path):
    real = tmp_path / "ros2"
    real.write_text("#!/bin/sh\necho real\n")
    real.chmod(0o755)
    env = {**bare_env, "PATH": f"{tmp_path}:{bare_env['PATH']}"}
    result = run("bash", "-c", f"source '{WORKSPACE}/setup_env.sh'; ros2 run a b", env=env)
    assert result.stdout.strip() == "real"


# --- the stand-in for the command `ros2`


@pytest.fixture
def fake_prefix(tmp_path) -> Path:
    """An install prefix with the package `fake`; its executable `talk` prints its process id and waits for SIGINT."""
    (tmp_path / "share/ament_index/resource_index/packages").mkdir(parents=True)
    (tmp_path / "share/ament_index/resource_index/packages/fake").touch()
    (tmp_path / "lib/fake").mkdir(parents=True)
    talk = tmp_path / "lib/fake/talk"
    talk.write_text('#!/bin/bash\ntrap "exit 3" INT\necho "$$ $*"\nwhile true; do sleep 0.05; done\n')
    talk.chmod(0o755)
    (tmp_path / "lib/fake/notes.txt").write_text("not executable")
    return tmp_path


@pytest.fixture
def fake_env(bare_env, fake_prefix) -> dict[str, str]:
    return {
        **bare_env,
        "PATH": f"{WORKSPACE}/shim:{bare_env['PATH']}",
        "AMENT_PREFIX_PATH": f"/nowhere:{fake_prefix}",
    }


def test_ros2_run_becomes_the_node_so_that_signals_reach_it(fake_env):
    process = subprocess.Popen(
        ["ros2", "run", "fake", "talk", "--ros-args", "-p", "a:=b c"],
        env=fake_env,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline().strip() == f"{process.pid} --ros-args -p a:=b c"
        process.send_signal(signal.SIGINT)
        assert process.wait(GUARD) == 3
    finally:
        process.kill()
        process.wait()


def test_ros2_pkg_executables_lists_what_can_be_run(fake_env, fake_prefix):
    assert run("ros2", "pkg", "executables", "fake", env=fake_env).stdout == "fake talk\n"
    assert run("ros2", "pkg", "executables", env=fake_env).stdout == "fake talk\n"
    assert run("ros2", "pkg", "prefix", "fake", env=fake_env).stdout.strip() == str(fake_prefix)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["run", "absent", "talk"], "Package 'absent' not found"),
        (["run", "fake", "absent"], "No executable 'absent' in package 'fake'; there are: talk"),
        (["run", "fake", "notes.txt"], "No executable 'notes.txt'"),
        (["pkg", "executables", "absent"], "Package 'absent' not found"),
        (["pkg", "prefix", "absent"], "Package 'absent' not found"),
        (["run", "fake"], "usage"),
        (["topic", "list"], "need an installed ROS 2"),
        ([], "usage"),
    ],
)
def test_ros2_says_what_is_wrong(fake_env, arguments, sentence):
    result = run("ros2", *arguments, env=fake_env)
    assert result.returncode != 0
    assert sentence in result.stderr
    assert result.stdout == ""


# --- what is missing on a machine


def path_with(tmp_path: Path, *names: str) -> str:
    """A PATH folder that holds these programs only."""
    for name in names:
        program = subprocess.run(["which", name], capture_output=True, text=True, check=True).stdout.strip()
        (tmp_path / name).symlink_to(program)
    return str(tmp_path)


def test_check_system_is_content_with_this_machine(bare_env):
    result = run("bash", WORKSPACE / "tools/check_system.sh", sys.executable, env=bare_env)
    assert result.returncode == 0, result.stderr


def test_check_system_names_what_is_missing_and_how_to_get_it(tmp_path):
    env = {"PATH": path_with(tmp_path, "bash", "sed", "sort", "head")}
    result = run("bash", WORKSPACE / "tools/check_system.sh", "python3.11", env=env)
    assert result.returncode == 1
    for word in ("Python 3.11", "C++ compiler", "cmake", "make", "sudo apt install"):
        assert word in result.stderr


def test_check_system_refuses_a_folder_with_blanks_in_its_path(bare_env, tmp_path):
    tools = tmp_path / "my projects/ros2_ws/tools"
    tools.mkdir(parents=True)
    script = tools / "check_system.sh"
    script.write_text((WORKSPACE / "tools/check_system.sh").read_text())
    result = run("bash", script, sys.executable, env=bare_env)
    assert result.returncode == 1
    assert "without blanks" in result.stderr and f"'{tmp_path}/my projects'" in result.stderr


def test_check_system_refuses_another_python_and_an_old_cmake(tmp_path):
    path = path_with(tmp_path, "bash", "sed", "sort", "head", "make", "c++")
    for name, answer in (("python3", "3.9"), ("cmake", "cmake version 3.10.2")):
        (tmp_path / name).write_text(f'#!/bin/bash\necho "{answer}"\n')
        (tmp_path / name).chmod(0o755)
    result = run("bash", WORKSPACE / "tools/check_system.sh", "python3", env={"PATH": path})
    assert result.returncode == 1
    assert "'python3' is 3.9" in result.stderr
    assert "found 3.10.2" in result.stderr


def test_underlay_stays_out_of_a_plain_build():
    assert (WORKSPACE / "underlay" / "COLCON_IGNORE").exists()
    assert (REPO_ROOT / "dgs_learning" / "COLCON_IGNORE").exists()


def test_type_descriptions_of_the_underlay_are_those_of_jazzy(ros_env):
    """Hashes computed from the definitions of control_msgs 5.8.0 and tf2_msgs 0.36 as released; equal hashes mean
    that nodes built here and nodes of an installed ROS understand one another."""
    released = {
        "control_msgs/action/FollowJointTrajectory": "738ebcb7a2d7cfa42f9f1001cc99ce3a4383d1cfe508015d9be8485e4b1c66f6",
        "control_msgs/msg/JointTolerance": "c254f9cece0f3b733017b6990fd46d1326e25242d6b8844398c97d9a88e7d648",
        "control_msgs/msg/JointComponentTolerance": "739ea7566931944d33830fa10f1bf5e7a7fbdc3172bce7a7eaac642bd6e3ffa4",
        "control_msgs/msg/JointTrajectoryControllerState": (
            "51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480"
        ),
        "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
        "tf2_msgs/msg/TF2Error": "db2485e7d6a0ec75bf087e058ee45df682acc3a621ca7780503d10aac141809a",
        "tf2_msgs/srv/FrameGraph": "0d1fbc6222c018ba5f33822904a2fdd4063705289956d3fdde07cd8c50fe8067",
        "tf2_msgs/action/LookupTransform": "0b8adf6bc0b5958879e3265b41a457e03558fe523890a81252c70eba97a82c5d",
    }
    for type_name, digest in released.items():
        package, kind, name = type_name.split("/")
        prefix = run("ros2", "pkg", "prefix", package, env=ros_env).stdout.strip()
        description = json.loads((Path(prefix) / "share" / package / kind / f"{name}.json").read_text())
        hashes = {entry["type_name"]: entry["hash_string"] for entry in description["type_hashes"]}
        assert hashes[type_name] == f"RIHS01_{digest}"
