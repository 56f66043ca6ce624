"""Calibrated arms: the numbers of ur_calibration's own test, and files that are not what they should be."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from dgs_description.arm_kinematics import CHOICE, nominal, of_ur3, read_kinematics
from dgs_description.arm_model import joint_frames
from dgs_description.errors import ErrorCode
from dgs_description.frames import Array
from tests.support.refused import refused
from tests.support.ur_calibration import a_ur3, dh_chain, drawn_in, write

HALF = 1.570796327
"""What the robot itself reports as pi/2."""
UR10 = np.array([
    [0.1273, 0, 0, 0.163941, 0.1157, 0.0922], [0, -0.612, -0.5723, 0, 0, 0], [0] * 6, [HALF, 0, 0, HALF, -HALF, 0],
])  # fmt: skip
UR10E = np.array([
    [0.1807, 0, 0, 0.17415, 0.11985, 0.11655], [0, -0.6127, -0.57155, 0, 0, 0], [0] * 6, [HALF, 0, 0, HALF, -HALF, 0],
])  # fmt: skip
# Rows d, a, theta, alpha: what the controllers of three real robots add to their tables (ur_calibration/test).
CALIBRATED = {
    "UR10": UR10 + [
        [0.00065609212979853, 1.4442162376284788, 0.854147723854608, -2.2989425877563705, -1.573498686836816e-05,
         1.9072435590711256e-05],
        [4.6311376834935676e-05, -0.00012568315331862312, 0.00186216581161458, 9.918593870679266e-05,
         4.215462720453189e-06, 0],
        [-7.290070070824746e-05, -0.01713897289704999, -0.03707159413492756, 0.054279462160583214,
         1.488984257025741e-07, 1.551499479707493e-05],
        [0.000211987863869334, -0.0072553625957652995, -0.013483226769541364, 0.0013495820227329425,
         -0.001263136163679901, 0],
    ],
    "UR10e": UR10E + [
        [-0.000144894975118076141, 303.469135666158195, -309.88394307789747, 6.41459904397394975,
         -4.48232900190081995e-05, -0.00087071402790364627],
        [0.000108651068627930392, 0.240324175250532346, 0.00180628180213493472, 2.63076149165684402e-05,
         3.96638632500012715e-06, 0],
        [1.59613525316931737e-07, -0.917209621528830232, 7.12936131346499469, 0.0710299029424392298,
         -1.64258976526054923e-06, 9.17286101034808787e-08],
        [-0.000444781952841921679, -0.00160215112531214153, 0.00631917793331091861, -0.00165055247340828437,
         0.000763682515545038854, 0],
    ],
    "UR10e again": UR10E + [
        [-0.000160188285741325043, 439.140974079900957, -446.027059806332147, 6.88618689642360149,
         -3.86588496858186748e-05, -0.00087908274257374186],
        [2.12234865571205891e-05, 0.632017132627700651, 0.00229833638891230319, -4.61409023720933908e-05,
         -6.39280053471801522e-05, 0],
        [-2.41478068943590252e-07, 1.60233952386694556, -1.68607190752171299, 0.0837331147700118711,
         -1.01260355871157781e-07, 3.91986209186123704e-08],
        [-0.000650246557584166496, 0.00139416666825590402, 0.00693818880325995126, -0.000811641562390219562,
         0.000411120504570705592, 0],
    ],
}  # fmt: skip

TABLE = {"UR10": UR10, "UR10e": UR10E, "UR10e again": UR10E}
MEDIAN = {"UR10": 4.2e-3, "UR10e": 1.8e-3, "UR10e again": 1.8e-3}
"""By which the table's flange is off, over random postures [m]: docs/arm_executor.md tells it."""


def flange(chain: Array, q: Array) -> Array:
    """(..., 4, 4) pose of the flange in the DH base, which is turned by pi against `base_link`."""
    return np.diag([-1.0, -1.0, 1.0, 1.0]) @ joint_frames(chain, q)[..., -1, :, :]


@pytest.mark.parametrize("robot", CALIBRATED)
def test_the_file_of_a_calibrated_robot_moves_as_its_controllers_table(robot: str, tmp_path: Path) -> None:
    chain = dh_chain(*CALIBRATED[robot])
    file = write(tmp_path / "calibration.yaml", drawn_in(chain), "calib_1")
    read = read_kinematics(file)
    # Drawn in: the frames lie where the links are, although the table's are up to 446 m away.
    assert read.name == "calib_1" and np.abs(read.origins[:, :3, 3]).max() < 0.7
    q = np.random.default_rng(0).uniform(-2 * np.pi, 2 * np.pi, (1000, 6))
    wanted, found = flange(chain, q), flange(read.origins, q)
    # 1e-12 is what the numbers hold over a metre; over 446 m it is 2e-13 of them.
    np.testing.assert_allclose(
        found[..., :3, 3], wanted[..., :3, 3], atol=1e-12 * max(1.0, np.abs(chain).max())
    )
    np.testing.assert_allclose(found[..., :3, :3], wanted[..., :3, :3], atol=1e-12)
    off = np.linalg.norm((found - flange(dh_chain(*TABLE[robot]), q))[..., :3, 3], axis=1)
    assert np.median(off) == pytest.approx(MEDIAN[robot], abs=1e-4)


def test_positions_that_a_simulated_ur10_reports() -> None:
    for q, place in (
        ((-1.6007002035724085, -1.7271001974688929, -2.2029998938189905, -0.807999912892477, 1.5951000452041626,
          -0.03099996248354131), (-0.179925914147547, -0.606869755162764, 0.230789102067257)),
        ((1.326450228691101, 2.426007747650146, 5.951572895050049, 1.274090409278869, -0.5410521666656214,
          0.12217304855585098), (0.39922988003280424, 0.59688365069340565, -0.66778190402763760)),
    ):  # fmt: skip
        np.testing.assert_allclose(flange(dh_chain(*UR10), np.array(q))[:3, 3], place, atol=1e-14)


def test_the_table_and_a_calibrated_ur3_pass(tmp_path: Path) -> None:
    read = read_kinematics(write(tmp_path / "calibration.yaml", a_ur3()))
    for arm in (nominal(), read):
        assert of_ur3(arm, "this") is arm
    np.testing.assert_allclose(read.origins, a_ur3(), atol=1e-14)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, 6))
    off = np.linalg.norm((flange(read.origins, q) - flange(nominal().origins, q))[..., :3, 3], axis=1)
    assert 5e-4 < np.median(off) < 5e-3


@pytest.mark.parametrize("robot", CALIBRATED)
def test_the_file_of_another_robot_is_refused(robot: str, tmp_path: Path) -> None:
    file = write(tmp_path / "calibration.yaml", drawn_in(dh_chain(*CALIBRATED[robot])))
    with refused(ErrorCode.PARAMETER_INVALID, r"is of another robot: forearm is 36\d\.\d mm"):
        of_ur3(read_kinematics(file), str(file))


def _shift(links: dict) -> None:
    links["wrist_2"]["y"] -= 0.012


WRONG = {
    "cannot be read \\(KeyError: 'wrist_3'": lambda links: links.pop("wrist_3"),
    "cannot be read \\(KeyError: 'hash'": lambda links: links.pop("hash"),
    "cannot be read \\(KeyError: 'yaw'": lambda links: links["forearm"].pop("yaw"),
    "cannot be read \\(ValueError": lambda links: links["forearm"].update(x="long"),
    "cannot be read \\(OverflowError": lambda links: links["forearm"].update(x=10**400),
    "cannot be read \\(TypeError": lambda links: links.update(forearm=None),
    "numbers that are not finite": lambda links: links["shoulder"].update(z=float("nan")),
    "of another robot: wrist_2 is 12": _shift,
    "of another robot: forearm is 0.* and 0.1": lambda links: links["forearm"].update(roll=0.1),
}


@pytest.mark.parametrize("words", WRONG)
def test_a_wrong_file_is_refused_with_what_is_wrong(words: str, tmp_path: Path) -> None:
    path = write(tmp_path / "calibration.yaml", a_ur3())
    file = yaml.safe_load(path.read_text())
    WRONG[words](file["kinematics"])
    path.write_text(yaml.safe_dump(file))
    with refused(ErrorCode.PARAMETER_INVALID, words):
        of_ur3(read_kinematics(path), str(path))


@pytest.mark.parametrize("text", ["kinematics: [", "", "[1, 2]", "\xff"])
def test_text_that_is_no_calibration_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "calibration.yaml"
    path.write_bytes(text.encode("latin-1"))
    with refused(ErrorCode.PARAMETER_INVALID, "needed are kinematics: shoulder, upper_arm"):
        read_kinematics(path)


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with refused(ErrorCode.DESCRIPTION_MISSING, f"in {CHOICE}, or unset it"):
        read_kinematics(tmp_path / "none.yaml")
    with refused(ErrorCode.PARAMETER_INVALID, "cannot be read .OSError"):
        read_kinematics(tmp_path / ("long" * 100))


def test_all_that_knows_the_arm_takes_the_file(tmp_path: Path) -> None:
    """Inverse kinematics, planning's Pinocchio model, the safety check's own chain, simulator and description."""
    code = """
import numpy as np, pybullet, pinocchio
from dgs_arm_executor.ik import T_TOOL0_TCP, ArmIK, dh_forward
from dgs_description.arm_model import forward_kinematics
from dgs_description.joints import ARM_JOINTS
from dgs_description.link_tree import LinkTree
from dgs_description.urdf import cell, urdf_path, urdf_text
ik, client = ArmIK(), pybullet.connect(pybullet.DIRECT)
body = pybullet.loadURDF(str(urdf_path("robot")), useFixedBase=True)
info = [pybullet.getJointInfo(body, k) for k in range(pybullet.getNumJoints(body))]
row = {i[1].decode(): i[0] for i in info}
tool = next(i[0] for i in info if i[12] == b"tool0")
ros = pinocchio.buildModelFromXML(urdf_text("cell_ros"))
assert not ik.is_dh
for q in np.random.default_rng(0).uniform(-2, 2, (20, 6)):
    T = forward_kinematics(q)
    assert np.abs(ik.forward(q) - T).max() < 1e-9
    assert np.abs(ik.forward_many(q[None])[0] - T).max() < 1e-9
    assert np.abs(LinkTree(cell()).poses(dict(zip(ARM_JOINTS, q)))["tool0"] - T).max() < 1e-12
    for name, angle in zip(ARM_JOINTS, q):
        pybullet.resetJointState(body, row[name], angle)
    place = pybullet.getLinkState(body, tool, computeForwardKinematics=True)[4]
    assert np.abs(np.array(place) - T[:3, 3]).max() < 1e-6
    found = ik.states(T @ T_TOOL0_TCP, q)
    assert np.abs(found - q).max(1).min() < 1e-6 and len(found) > 1
    assert max(np.abs(forward_kinematics(state) - T).max() for state in found) < 1e-8
    values = pinocchio.neutral(ros)
    for name, angle in zip(ARM_JOINTS, q):
        values[ros.joints[ros.getJointId(name)].idx_q] = angle
    data = ros.createData()
    pinocchio.framesForwardKinematics(ros, data, values)
    assert np.abs(data.oMf[ros.getFrameId("tool0")].homogeneous - T).max() < 1e-9
print("same")
"""
    done = in_process_with(write(tmp_path / "calibration.yaml", a_ur3()), code)
    assert done.stdout.strip().endswith("same"), done.stderr


def in_process_with(file: Path, code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, CHOICE: str(file)},
        capture_output=True,
        text=True,
        timeout=120,
    )
