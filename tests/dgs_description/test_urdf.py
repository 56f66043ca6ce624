"""The URDF files: committed text, both readers, mapping by name, kinematics, masses, what stands where."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio
import pybullet
import pytest
from pybullet_utils.bullet_client import BulletClient

from dgs_description import arm_model, joints, urdf, urdf_parts
from dgs_description.cell import CELL, Cell
from dgs_description.errors import ErrorCode
from dgs_description.frames import CAMERA_OPTICAL, HAND_TCP, TOOL0, from_quaternion, inverse
from dgs_description.hand import CHOICE, DEFAULT, HAND
from dgs_description.hand_file import LINKS
from dgs_description.link_tree import LinkTree
from tests.support.refused import refused

PACKAGE = Path(urdf.__file__).parent
HAND_MASS = 1.5
"""The makers' figure for the whole hand [kg]; the parts are weighed separately."""
ROS_NAMES = [name for name in urdf.NAMES if name.endswith("_ros")]
CAPSULE_NAMES = [name for name in urdf.NAMES if name not in ROS_NAMES]


class PinocchioRobot:
    """Frames of a URDF by name, joints given by name."""

    def __init__(self, name: str):
        self.model, self.collision, _ = pinocchio.buildModelsFromUrdf(str(urdf.urdf_path(name)))
        self.data = self.model.createData()

    def frames(self, values: dict[str, float]) -> None:
        q = pinocchio.neutral(self.model)
        for joint, value in values.items():
            q[self.model.joints[self.model.getJointId(joint)].idx_q] = value
        pinocchio.framesForwardKinematics(self.model, self.data, q)

    def frame(self, name: str) -> np.ndarray:
        assert self.model.existFrame(name), name
        return self.data.oMf[self.model.getFrameId(name)].homogeneous


class BulletRobot:
    """The same through PyBullet."""

    def __init__(self, name: str):
        self.bullet = BulletClient(pybullet.DIRECT)
        self.body = self.bullet.loadURDF(str(urdf.urdf_path(name)), useFixedBase=True)
        count = self.bullet.getNumJoints(self.body)
        self.bullet.performCollisionDetection()  # or rays miss the links
        info = [self.bullet.getJointInfo(self.body, k) for k in range(count)]
        self.joints = {row[1].decode(): row for row in info}
        self.links = {row[12].decode(): row[0] for row in info}

    def frames(self, values: dict[str, float]) -> None:
        for joint, value in values.items():
            self.bullet.resetJointState(self.body, self.joints[joint][0], value)

    def frame(self, name: str) -> np.ndarray:
        state = self.bullet.getLinkState(self.body, self.links[name], computeForwardKinematics=True)
        return from_quaternion(state[4], state[5])

    def masses(self) -> dict[str, float]:
        return {link: self.bullet.getDynamicsInfo(self.body, k)[0] for link, k in self.links.items()}


def random_joints(seed: int) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    rng = np.random.default_rng(seed)
    arm = rng.uniform(joints.ARM_LOWER, joints.ARM_UPPER)
    hand = rng.uniform(HAND.lower, HAND.upper)
    # A shuffled mapping: neither reader may depend on our order.
    names = [*joints.ARM_JOINTS, *HAND.joints]
    values = np.concatenate([arm, hand])
    order = rng.permutation(len(names))
    return arm, hand, {names[k]: float(values[k]) for k in order}


@pytest.mark.parametrize("name", urdf.NAMES)
def test_committed_file_is_what_the_module_writes(name: str) -> None:
    assert (PACKAGE.parent / "urdf" / f"{name}.urdf").read_text() == urdf.urdf_text(name)


def test_no_other_urdf_is_committed() -> None:
    assert {path.stem for path in (PACKAGE.parent / "urdf").glob("*")} == set(urdf.NAMES)


def test_command_rewrites_all_files(tmp_path: Path) -> None:
    copy = tmp_path / "source"
    shutil.copytree(PACKAGE, copy / "dgs_description", ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run(
        [sys.executable, "-m", "dgs_description.urdf"], cwd=copy, check=True, env={"PYTHONPATH": str(copy)}
    )
    for name in urdf.NAMES:
        assert (copy / "urdf" / f"{name}.urdf").read_text() == urdf.urdf_text(name)


def test_path_is_found_in_an_install_without_sources(tmp_path: Path) -> None:
    site = tmp_path / "lib" / "python3.11" / "site-packages"
    shutil.copytree(PACKAGE, site / "dgs_description", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(PACKAGE.parent / "urdf", tmp_path / "share" / "dgs_description" / "urdf")
    code = "from dgs_description.urdf import urdf_path; print(urdf_path('cell'))"
    printed = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        check=True,
        env={"PYTHONPATH": str(site)},
        capture_output=True,
    )
    assert (
        Path(printed.stdout.decode().strip()) == tmp_path / "share" / "dgs_description" / "urdf" / "cell.urdf"
    )


def test_a_hand_on_an_adapter_may_keep_its_name_and_is_where_its_folder_says(tmp_path: Path) -> None:
    folder = shutil.copytree(PACKAGE / "hands" / DEFAULT, tmp_path / DEFAULT)
    file = folder / "hand.yaml"
    file.write_text(re.sub(r"(?m)^mount: .*", "mount: [0.0, 0.0, 0.0322]", file.read_text()))
    code = "from dgs_description.urdf import urdf_path; print(urdf_path('cell'))"
    environment = {**os.environ, CHOICE: str(folder)}
    command = [sys.executable, "-c", code]
    printed = subprocess.run(command, check=True, env=environment, capture_output=True, text=True)
    assert '<origin xyz="0 0 0.0322" rpy="0 0 0" />' in Path(printed.stdout.strip()).read_text()


def test_unknown_name_is_refused_with_the_names_there_are() -> None:
    with refused(ErrorCode.DESCRIPTION_MISSING, "cell, robot"):
        urdf.urdf_path("cel")


@pytest.mark.parametrize(
    ("reader", "name", "error"),
    [
        *((PinocchioRobot, name, 1e-9) for name in ("cell", "cell_ros", "robot")),
        (BulletRobot, "cell", 1e-6),
    ],
)
def test_tool0_follows_the_dh_table(reader: Callable[[str], Any], name: str, error: float) -> None:
    robot = reader(name)
    for seed in range(20):
        arm, _, values = random_joints(seed)
        robot.frames(values)
        np.testing.assert_allclose(robot.frame(TOOL0), arm_model.forward_kinematics(arm), rtol=0, atol=error)


@pytest.mark.parametrize("name", ["cell", "dexhand", "floating_hand", "dexhand_ros"])
@pytest.mark.parametrize("reader", ["pinocchio", "pybullet"])
def test_fingers_agree_with_the_hand_model(name: str, reader: str) -> None:
    robot = PinocchioRobot(name) if reader == "pinocchio" else BulletRobot(name)
    for seed in range(10):
        _, hand, values = random_joints(seed)
        robot.frames(
            {joint: value for joint, value in values.items() if joint in HAND.joints or name == "cell"}
        )
        # PyBullet counts the root link as base, not as a link.
        T_world_tcp = np.eye(4) if (reader, name) == ("pybullet", "floating_hand") else robot.frame(HAND_TCP)
        expected = HAND.link_frames(hand)
        tips = HAND.fingertips(hand)
        for f, finger in enumerate(HAND.fingers):
            for k, phalanx in enumerate(LINKS):
                T_tcp_link = inverse(T_world_tcp) @ robot.frame(f"{finger}_{phalanx}")
                np.testing.assert_allclose(T_tcp_link, expected[f, k], rtol=0, atol=2e-6)
            tip = (inverse(T_world_tcp) @ robot.frame(f"{finger}_tip"))[:3, 3]
            np.testing.assert_allclose(tip, tips[f], rtol=0, atol=1e-6)


def test_limits_are_those_of_the_joints_module() -> None:
    model = PinocchioRobot("cell").model
    hand = zip(HAND.joints, HAND.lower, HAND.upper, HAND.effort, strict=True)
    arm = zip(joints.ARM_JOINTS, joints.ARM_LOWER, joints.ARM_UPPER, joints.ARM_EFFORT, strict=True)
    for joint, lower, upper, effort in [*hand, *arm]:
        q, v = model.joints[model.getJointId(joint)].idx_q, model.joints[model.getJointId(joint)].idx_v
        np.testing.assert_allclose(model.lowerPositionLimit[q], lower, atol=1e-9)
        np.testing.assert_allclose(model.upperPositionLimit[q], upper, atol=1e-9)
        np.testing.assert_allclose(model.upperEffortLimit[v], effort, atol=1e-9)
    for k, joint in enumerate(joints.ARM_JOINTS):
        v = model.joints[model.getJointId(joint)].idx_v
        np.testing.assert_allclose(model.upperVelocityLimit[v], joints.ARM_VELOCITY[k], atol=1e-9)


def test_distal_joints_copy_the_middle_ones() -> None:
    model = pinocchio.buildModelFromUrdf(str(urdf.urdf_path("cell_ros")), mimic=True)
    assert model.nq == 6 + 15


@pytest.mark.parametrize("name", urdf.NAMES)
def test_every_link_states_its_inertia(name: str) -> None:
    links = ElementTree.fromstring(urdf.urdf_text(name)).findall("link")
    # KDL, which robot_state_publisher uses, takes no inertia on the root.
    assert [link.get("name") for link in links if link.find("inertial") is None] == (
        [links[0].get("name")] if name in ROS_NAMES else []
    )
    for inertia in ElementTree.fromstring(urdf.urdf_text(name)).iter("inertia"):
        ixx, iyy, izz, ixy, ixz, iyz = (
            float(inertia.get(key)) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
        )
        moments = np.linalg.eigvalsh([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        assert moments[0] > 0
        assert moments[0] + moments[1] >= moments[2] * (1 - 1e-4), "no body has such moments"


def test_hand_weighs_what_its_maker_says() -> None:
    assert sum(BulletRobot("floating_hand").masses().values()) == pytest.approx(HAND_MASS, abs=0.01)
    arm_masses = BulletRobot("robot").masses()
    arm = sum(
        mass for link, mass in arm_masses.items() if link.startswith(("shoulder", "upper", "fore", "wrist"))
    )
    assert arm == pytest.approx(8.63, abs=1e-6)


@pytest.mark.parametrize("name", CAPSULE_NAMES)
def test_capsules_reach_both_readers_as_capsules(name: str) -> None:
    text = urdf.urdf_text(name)
    capsules = text.count("<capsule") // (2 if "<visual>" in text else 1)
    shapes = PinocchioRobot(name).collision.geometryObjects
    assert sum(type(shape.geometry).__name__ == "Capsule" for shape in shapes) == capsules
    robot = BulletRobot(name)
    found = [
        shape
        for k in range(-1, len(robot.links))
        for shape in robot.bullet.getCollisionShapeData(robot.body, k)
    ]
    assert sum(shape[2] == pybullet.GEOM_CAPSULE for shape in found) == capsules
    assert capsules >= 2


@pytest.mark.parametrize("name", ROS_NAMES)
def test_ros_variants_hold_only_what_old_readers_know(name: str) -> None:
    robot = ElementTree.fromstring(urdf.urdf_text(name))
    assert robot.get("version") == "1.0"
    kinds = {geometry[0].tag for geometry in robot.iter("geometry")}
    assert kinds <= {"box", "cylinder", "sphere"}


@pytest.mark.parametrize("finger", HAND.fingers)
def test_finger_capsules_lie_where_the_hand_model_has_them(finger: str) -> None:
    shapes = {shape.name: shape for shape in PinocchioRobot("floating_hand").collision.geometryObjects}
    robot = PinocchioRobot("floating_hand")
    for phalanx, capsule in zip(LINKS[1:], HAND.capsules[0], strict=True):
        shape = shapes[f"{finger}_{phalanx}_0"]
        joint = robot.model.frames[robot.model.getFrameId(f"{finger}_{phalanx}")].placement
        T_link_shape = joint.inverse() * shape.placement
        ends = [T_link_shape * np.array([0, 0, side * shape.geometry.halfLength]) for side in (-1, 1)]
        expected = [[0, capsule.start, capsule.height], [0, capsule.end, capsule.height]]
        np.testing.assert_allclose(sorted(ends, key=lambda end: end[1]), expected, atol=1e-9)
        assert shape.geometry.radius == capsule.radius


def test_camera_stands_where_the_cell_says() -> None:
    for robot in (PinocchioRobot("cell"), BulletRobot("surroundings")):
        robot.frames({})
        np.testing.assert_allclose(robot.frame(CAMERA_OPTICAL), CELL.T_base_camera_optical, rtol=0, atol=1e-6)


@pytest.mark.filterwarnings("error")
def test_a_camera_may_look_straight_down(monkeypatch: pytest.MonkeyPatch) -> None:
    down = Cell(camera_position=(0.3, 0.0, 0.8), camera_quaternion_xyzw=(1.0, 0.0, 0.0, 0.0))
    monkeypatch.setattr(urdf_parts, "CELL", down)
    poses = LinkTree(urdf_parts.surroundings()).poses({})
    np.testing.assert_allclose(poses[CAMERA_OPTICAL], down.T_base_camera_optical, atol=1e-12)


def test_surroundings_stand_where_the_cell_says() -> None:
    robot = BulletRobot("surroundings")

    def surface(x: float, y: float) -> tuple[float, int]:
        """Height and link of the first thing below (x, y), from just above the bin."""
        start = CELL.table_height + CELL.bin_size[2] + 0.01
        hit = robot.bullet.rayTest((x, y, start), (x, y, -1.0))[0]
        return hit[3][2], hit[1]

    for corner in (CELL.workspace_bounds[0], CELL.workspace_bounds[1]):
        height, link = surface(*corner[:2])
        assert (height, link) == (pytest.approx(CELL.table_height, abs=1e-3), robot.links["table"])
    x, y = CELL.bin_centre
    assert surface(x, y) == (pytest.approx(CELL.table_height + CELL.bin_wall, abs=1e-3), robot.links["bin"])
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        rim_x = x + dx * (CELL.bin_size[0] - CELL.bin_wall) / 2
        rim_y = y + dy * (CELL.bin_size[1] - CELL.bin_wall) / 2
        assert surface(rim_x, rim_y)[0] == pytest.approx(CELL.table_height + CELL.bin_size[2], abs=1e-3)


def test_camera_sees_the_workspace_past_its_own_stand() -> None:
    robot = BulletRobot("surroundings")
    eye = CELL.T_base_camera_optical[:3, 3]
    low, high = CELL.workspace_bounds
    for x in np.linspace(low[0], high[0], 5):
        for y in np.linspace(low[1], high[1], 5):
            target = np.array([x, y, CELL.table_height - 0.001])
            start = eye + 0.01 * (target - eye)
            hit = robot.bullet.rayTest(start.tolist(), target.tolist())[0]
            assert hit[1] == robot.links["table"]
