"""The hands that come with the suite, and what a hand's folder may not say."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from dgs_description.errors import ErrorCode
from dgs_description.hand import CHOICE
from dgs_description.hand_file import FILE, HANDS, hand_names, hand_of, load_hand
from dgs_description.hand_ik import inverse_kinematics, reach_with_balls
from dgs_description.hand_model import HandModel
from tests.support.hands import grasps_of_a_block, in_process_of
from tests.support.refused import refused

COUNTS = {"dexhand_pro": (5, 15), "dexhand_021": (5, 12), "allegro": (4, 16)}
"""Fingers and motors by the makers."""


def postures(hand: HandModel, count: int, seed: int = 0) -> np.ndarray:
    """(N, 4 F) joints that the couplings allow."""
    drawn = np.random.default_rng(seed).uniform(hand.lower, hand.upper, (count, hand.joint_count))
    return np.clip(hand.settled(hand.expand(hand.reduce(drawn))), hand.lower, hand.upper)


def test_these_hands_come_with_the_suite() -> None:
    assert hand_names() == sorted(COUNTS)
    assert {n: (load_hand(n).finger_count, len(load_hand(n).driven)) for n in COUNTS} == COUNTS


@pytest.mark.parametrize("name", COUNTS)
def test_joints_that_follow_do_so_and_locked_ones_stand(name: str) -> None:
    hand = load_hand(name)
    q = hand.expand(np.random.default_rng(1).uniform(0, 1, len(hand.driven)))
    free = ~hand.locked
    np.testing.assert_array_equal(q[free], (q[hand.source] * hand.ratio)[free])
    np.testing.assert_array_equal(q[hand.locked], hand.lower[hand.locked])
    np.testing.assert_allclose(hand.settled(q), q, atol=1e-15)


@pytest.mark.parametrize("name", hand_names())
def test_every_posture_that_the_suite_commands_is_within_limits_and_coupled(name: str) -> None:
    hand = load_hand(name)
    for joints in (hand.open_hand, hand.straight, hand.pre_grasp(hand.upper), hand.pre_grasp(hand.lower)):
        assert (hand.lower - 1e-12 <= joints).all() and (joints <= hand.upper + 1e-12).all()
        assert np.array_equal(joints, hand.expand(hand.reduce(joints)))
    assert not hand.beyond[~hand.flexes].any() and (hand.beyond[hand.flexes] > 0).all()


def test_a_hand_that_is_turned_on_its_flange(tmp_path: Path) -> None:
    file = yaml.safe_load((HANDS / "dexhand_pro" / FILE).read_text())
    straight = load_hand("dexhand_pro")
    turned = hand_of(file | {"mount_rpy": [0.0, 0.0, np.pi / 2]}, "dexhand_pro")
    across = straight.T_mount_tcp[:3, 3] @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    assert np.allclose(turned.T_mount_tcp[:3, 3], across)
    assert np.allclose(turned.T_mount_base[:3, :3] @ [1, 0, 0], [0, 1, 0])


def test_what_follows_narrows_the_limits_of_what_it_follows() -> None:
    file = yaml.safe_load((HANDS / "dexhand_021" / FILE).read_text())
    file["fingers"]["index"]["joints"][3] = {
        "lower": -1.0,
        "upper": 0.5,
        "effort": 0.5,
        "follows": "joint3",
        "ratio": 0.8,
    }
    hand = hand_of(file, "dexhand_021")
    row = hand.joints.index("index_joint3")
    assert (hand.lower[row], hand.upper[row]) == (0.0, pytest.approx(0.625))
    assert hand.expand(hand.reduce(hand.upper))[row + 1] == pytest.approx(0.5)
    file["fingers"]["index"]["joints"][3] |= {"lower": -1.0, "upper": -0.5}
    with pytest.raises(
        ValueError, match="index_joint4 follows index_joint3, but their limits have nothing in common"
    ):
        hand_of(file, "dexhand_021")


def test_the_open_hand_is_within_the_limits_that_what_follows_leaves() -> None:
    file = yaml.safe_load((HANDS / "dexhand_021" / FILE).read_text())
    file["joints"][0] |= {"lower": 0.1, "upper": 0.5}
    for finger in ("index", "ring", "little"):
        del file["fingers"][finger]["spread"]
    hand = hand_of(file, "dexhand_021")
    assert hand.split(hand.open_hand)[1, 0] == pytest.approx(-0.1)
    file["fingers"]["index"]["spread"] = -0.55
    with pytest.raises(ValueError, match="fingers.index.spread lies outside of joint1's limits"):
        hand_of(file, "dexhand_021")


def test_one_motor_spreads_three_fingers() -> None:
    hand = load_hand("dexhand_021")
    q = hand.split(hand.expand(np.where(np.array(hand.driven_joints) == "index_joint1", -0.3, 0.0)))
    np.testing.assert_allclose(q[:, 0], [0.0, -0.3, 0.0, 0.3, 0.3])


@pytest.mark.parametrize("name", COUNTS)
def test_the_urdf_has_the_same_fingertips(name: str) -> None:
    code = """
import numpy as np, pinocchio
from dgs_description.hand import HAND
from dgs_description.urdf import urdf_path
model = pinocchio.buildModelFromUrdf(str(urdf_path("floating_hand")))
data, rng = model.createData(), np.random.default_rng(0)
for _ in range(20):
    q = HAND.expand(HAND.reduce(rng.uniform(HAND.lower, HAND.upper)))
    values = np.zeros(model.nq)
    for joint, angle in zip(HAND.joints, q):
        values[model.joints[model.getJointId(joint)].idx_q] = angle
    pinocchio.framesForwardKinematics(model, data, values)
    tips = [data.oMf[model.getFrameId(f + "_tip")].translation for f in HAND.fingers]
    assert np.abs(tips - HAND.fingertips(q)).max() < 1e-5, np.abs(tips - HAND.fingertips(q)).max()
    frames = HAND.link_frames(q)
    distal = [data.oMf[model.getFrameId(f + "_distal")].homogeneous for f in HAND.fingers]
    assert np.abs(distal - frames[:, 3]).max() < 1e-5
print("same")
"""
    assert "same" in in_process_of(name, code).split()


@pytest.mark.parametrize(
    ("name", "median"), [("dexhand_pro", 1e-9), ("dexhand_021", 1e-9), ("allegro", 1e-4)]
)
def test_inverse_kinematics_of_every_hand(name: str, median: float) -> None:
    hand = load_hand(name)
    q = postures(hand, 100)
    for points, inverse in ((hand.fingertips, inverse_kinematics), (hand.end_balls, reach_with_balls)):
        found = inverse(hand, points(q))
        flat = found.reshape(len(q), -1)
        assert (flat >= hand.lower - 1e-9).all() and (flat <= hand.upper + 1e-9).all()
        error = np.linalg.norm(points(found) - points(q), axis=-1)
        assert np.median(error) < max(median, 1e-4 if inverse is reach_with_balls else 0.0)
        assert np.percentile(error, 80 if name == "allegro" else 99, axis=0).max() < 0.005


def test_fingers_that_bend_backwards_reach_what_is_there() -> None:
    lower = load_hand("dexhand_pro").lower.reshape(-1, 4).copy()
    lower[:, 2:] = -0.3
    hand = replace(load_hand("dexhand_pro"), lower=lower.ravel())
    q = postures(hand, 200)
    for points, inverse in ((hand.fingertips, inverse_kinematics), (hand.end_balls, reach_with_balls)):
        error = np.linalg.norm(points(inverse(hand, points(q))) - points(q), axis=-1)
        assert np.percentile(error, 95) < 1e-3


@pytest.mark.parametrize("name", COUNTS)
def test_end_balls_move_as_their_jacobian_says(name: str) -> None:
    hand = load_hand(name)
    q, small = postures(hand, 20), 1e-6
    balls, jacobian = hand.end_ball_jacobian(q)
    assert np.allclose(balls, hand.end_balls(q), atol=1e-12)
    for k in range(4):
        step = small * np.eye(4)[k]
        moved = hand.end_balls(hand.split(q) + step) - hand.end_balls(hand.split(q) - step)
        assert np.allclose(jacobian[..., k], moved / (2 * small), atol=1e-7)


@pytest.mark.parametrize("name", COUNTS)
def test_both_engines_carry_every_hand(name: str) -> None:
    code = """
import numpy as np
from dgs_description.frames import transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import HAND
from dgs_description.pick import closing_limit
from dgs_sim_bridge.world.engines import ENGINES, open_world
for engine in ENGINES:
    with open_world(engine, [], [], True) as world:
        world.put_hand(transform(np.diag([1.0, -1.0, -1.0]), (0, 0, 0.6)), HAND.open_hand)  # pointing down
        bent = np.where(HAND.flexes.ravel(), 0.3, HAND.open_hand)
        bent = np.clip(HAND.expand(HAND.reduce(bent)), HAND.lower, HAND.upper)
        before, final = HAND.open_hand[None], bent[None]
        grasp = GraspSet.of(
            "test", position=np.zeros((1, 3)), rotation=np.eye(3)[None], pre_grasp_joints=before, grasp_joints=final,
            active_fingers=True,
        )[0]
        world.start_closing(grasp, 1.0)
        for _ in range(round(1.5 / world.period)):
            world.step()
        wanted = closing_limit(bent, grasp.active_fingers)
        error = np.abs(world.joints()[0] - wanted).reshape(HAND.shape)[HAND.flexes]
        assert error.max() < 0.05, (engine, error.round(3))
print("both")
"""
    assert "both" in in_process_of(name, code).split()


def test_a_palm_that_is_turned_against_the_approach_is_swept_along_it() -> None:
    code = """
import numpy as np
from dgs_description.frames import apply
from dgs_description.hand import HAND
from dgs_description.pick import STAND_OFF
from dgs_grasp_planner import check
check.CLOUD_POINTS = 0
points = np.random.default_rng(0).uniform(-0.25, 0.25, (20_000, 3))
found = check._palm_in_cloud(np.arange(len(points)), points.astype(np.float32), len(points), STAND_OFF)
low, high = HAND.palm_boxes[:, 0::2] + check.CLOUD_DEPTH, HAND.palm_boxes[:, 1::2] - check.CLOUD_DEPTH
met = np.zeros(len(points), dtype=bool)
for back in np.linspace(0.0, STAND_OFF, 401):
    local = apply(HAND.T_base_tcp, points + (0.0, 0.0, back))[:, None]
    met |= ((local > low) & (local < high)).all(axis=2).any(axis=1)
assert not (met & ~found).any() and 0.01 < met.mean() < 0.5
print((found & ~met).sum() < 20)  # between two steps
"""
    assert in_process_of("dexhand_021", code).strip().endswith("True")


@pytest.mark.parametrize("name", hand_names())
def test_every_hand_finds_grasps_on_a_table(name: str) -> None:
    assert grasps_of_a_block(name) > 0


def test_weights_and_grasps_of_another_hand_are_refused() -> None:
    code = """
from dgs_description.errors import DgsError
from dgs_description.paths import models_dir
from dgs_grasp_planner.network import load_network
from dgs_learning.dataset import load_dataset
for what in (lambda: load_network(models_dir(), "dgs_net"), lambda: load_dataset(models_dir() / "dataset.npz")):
    try:
        what()
    except DgsError as error:
        print(int(error.code), error.message)
"""
    told = in_process_of("allegro", code).strip().splitlines()[-2:]
    assert all(line.startswith(f"{int(ErrorCode.WRONG_HAND)} ") for line in told), told
    assert all("hand dexhand_pro, not for allegro: set DGS_HAND=dexhand_pro" in line for line in told), told


def test_a_hand_may_lie_in_a_folder_of_ones_own(tmp_path: Path) -> None:
    folder = tmp_path / "mine"
    folder.mkdir()
    text = (HANDS / "allegro" / FILE).read_text().replace("name: allegro", "name: mine")
    text = re.sub(r"\bthumb\b", "first", text)
    (folder / FILE).write_text(text.replace("friction: 0.02", "friction: 2e-2"))
    assert load_hand(folder).name == "mine" and load_hand(folder).friction == 0.02
    code = "from dgs_learning.validation import HAND, THUMB_PITCH; print(HAND.joints[THUMB_PITCH])"
    assert in_process_of(folder, code).strip().endswith("first_joint2")


def test_an_unknown_hand_is_refused() -> None:
    with refused(ErrorCode.DESCRIPTION_MISSING, "there are allegro, dexhand_021, dexhand_pro, or .* ./claw"):
        load_hand("claw")


def test_a_misspelt_choice_ends_every_program_with_one_sentence() -> None:
    command = [sys.executable, "-c", "import dgs_description.hand"]
    done = subprocess.run(
        command, env={**os.environ, CHOICE: "claw"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    (sentence,) = done.stderr.splitlines()
    assert sentence.startswith("DGS_HAND: no hand 'claw'") and "there are allegro, dexhand_021" in sentence


def _pattern(file: dict, *fingers: str) -> None:
    file["grasp"]["patterns"][0] = list(fingers)


def _level(file: dict, fingers: list[str]) -> None:
    level = {"fingers": fingers, "thumb_between": ["index"], "thumb_shift": 0.0, "lean": 0.0}
    file["grasp"]["level_pinch"] = level


def _push(file: dict, fingers: list[str], bend: list[float]) -> None:
    file["grasp"]["push"] = {"fingers": fingers, "bend": bend}


WRONG = {
    "fingers.thumb.palmar points along the finger": lambda f: f["fingers"]["thumb"].update(palmar=[0, 1, 0]),
    "lacks 'tcp'": lambda f: f.pop("tcp"),
    "protocol must be `module:Class`": lambda f: f.update(protocol="CAN bus"),
    "has unknown keys: colour": lambda f: f.update(colour="red"),
    "joints[1] has a lower limit that is not below": lambda f: f["joints"][1].update(lower=2.0),
    "joints[2].effort must be a finite number of at least": lambda f: f["joints"][2].update(effort=0),
    "tcp[0] must be a number": lambda f: f.update(tcp=["a", 0, 0]),
    "tcp must be a list of 3": lambda f: f.update(tcp=[0, 0]),
    "mapping of two to five fingers": lambda f: f.update(fingers={"thumb": f["fingers"]["thumb"]}),
    "names 'little'; there are thumb, index, middle, ring": lambda f: _pattern(f, "thumb", "little"),
    "the thumb always among them": lambda f: _pattern(f, "index", "middle"),
    "joints[3].follows names 'joint9'": lambda f: f["joints"][3].update(follows="joint9"),
    "follows another": lambda f: (f["joints"][3].update(follows="joint3"), f["joints"][2].update(follows="joint2")),
    "grasp has unknown keys: widist": lambda f: f["grasp"].update(widist=0.1),
    "palm has unknown keys: True, weight": lambda f: f["palm"].update({True: [0, 0], "weight": 1.0}),  # on: in YAML
    "tcp[1] must be a finite number": lambda f: f.update(tcp=[0, 10**400, 0]),
    "links.distal has unknown keys: lenght": lambda f: f["links"]["distal"].update(lenght=0.1),
    "joints[1].follows names the joint itself": lambda f: f["joints"][1].update(follows="joint2", ratio=0.5),
    "fingers.thumb.links has unknown keys: distel": lambda f: f["fingers"]["thumb"]["links"].update(distel={"to": 0}),
    "links.distal has unknown keys: mass": lambda f: f["fingers"]["thumb"]["links"]["distal"].update(mass=0.05),
    "fingers.index.links must be a mapping": lambda f: f["fingers"]["index"].update(links=[0.02]),
    "links.knuckle has unknown keys: radius": lambda f: f["links"]["knuckle"].update(radius=0.01),
    "grasp.stiffness[0] must be a finite number of at least": lambda f: f["grasp"].update(stiffness=[0, 5, 2, 2]),
    "joints[1].ratio must not be 0": lambda f: f["joints"][1].update(follows="joint3", ratio=0),
    "joints[1].ratio needs a `follows`": lambda f: f["joints"][1].update(ratio=0.5),
    "joints[3].at goes with nothing else": lambda f: f["joints"][3].update(at=0.1),
    "level_pinch.fingers must name the thumb and another": lambda f: _level(f, ["index", "middle"]),
    "push.fingers must name two": lambda f: _push(f, ["index", "index"], [0, 0, 0, 0]),
    "push.bend is beyond the limits of joint2 of ring": lambda f: _push(f, ["index", "ring"], [0, 0, 0.5, 2.0]),
    "joints[3] must be a mapping": lambda f: f["joints"].__setitem__(3, None),
    "palm.boxes must name one box at least": lambda f: f["palm"].update(boxes=[]),
    "palm.boxes[0] must be x0, x1": lambda f: f["palm"].update(boxes=[[0.02, -0.02, -0.05, 0.05, -0.09, 0.0]]),
    "links.distal.spheres must be a whole number": lambda f: f["links"]["distal"].update(spheres=2.7),
    "fingers.index.spread lies outside of joint1's limits": lambda f: f["fingers"]["index"].update(spread=1.0),
    "the folder's name is": lambda f: f.update(name="other"),
}  # fmt: skip


@pytest.mark.parametrize("words", WRONG)
def test_a_wrong_file_is_refused_with_its_place(words: str, tmp_path: Path) -> None:
    file = yaml.safe_load((HANDS / "allegro" / FILE).read_text())
    file["name"] = "mine"
    WRONG[words](file)
    folder = tmp_path / "mine"
    folder.mkdir()
    (folder / FILE).write_text(yaml.safe_dump(file, sort_keys=False))
    with refused(ErrorCode.PARAMETER_INVALID, re.escape(words)):
        load_hand(folder)


def test_text_that_is_no_yaml_and_a_folder_that_cannot_be_looked_into_are_refused(tmp_path: Path) -> None:
    (tmp_path / FILE).write_text("name: [")
    for folder in (tmp_path, tmp_path / ("long" * 100)):
        with refused(ErrorCode.PARAMETER_INVALID, "cannot be read"):
            load_hand(folder)


def test_a_hand_whose_thumb_cannot_be_at_zero_pushes_within_its_limits(tmp_path: Path) -> None:
    code = """
import numpy as np
from dgs_description.hand import HAND
from dgs_grasp_planner.propose.push import _pushing_hand
joints = _pushing_hand().joints
assert HAND.lower[0] > 0 and (HAND.lower <= joints).all() and (joints <= HAND.upper).all(), joints
assert HAND.split(joints)[:, 1].tolist() == [0.0, 0.1, 0.5, 0.1], joints
"""
    file = yaml.safe_load((HANDS / "allegro" / FILE).read_text())
    _push(file, ["index", "ring"], [0.0, 0.1, 0.5, 0.1])
    (tmp_path / "allegro").mkdir()
    (tmp_path / "allegro" / FILE).write_text(yaml.safe_dump(file, sort_keys=False))
    in_process_of(tmp_path / "allegro", code)


def test_penetration_knows_every_finger_of_its_own() -> None:
    code = """
import numpy as np
from dgs_description.hand import HAND
from dgs_learning.evaluation.penetration import hand_parts
solids = hand_parts(HAND.open_hand)[len(HAND.palm_boxes):]
for finger, ball in enumerate(HAND.end_balls(HAND.open_hand)):
    box = np.array(solids[3 * finger + 2].bounding_box()).reshape(2, 3)
    inside = np.minimum(ball - box[0], box[1] - ball).min()
    assert abs(inside - HAND.ball_radius) < 2e-3, (HAND.fingers[finger], inside)
print("own")
"""
    assert in_process_of("allegro", code).strip().endswith("own")
