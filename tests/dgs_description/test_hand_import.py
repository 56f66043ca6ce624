"""A hand's URDF becomes a hand folder with the same kinematics."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from dgs_description import hand_import, hand_stance
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.hand import CHOICE
from dgs_description.hand_file import FILE, load_hand
from dgs_description.hand_import import import_hand
from dgs_description.hand_model import HandModel
from tests.support.hands import grasps_of_a_block
from tests.support.refused import refused


def urdf_of(hand: str) -> Path:
    code = "from dgs_description.urdf import urdf_path; print(urdf_path('dexhand'))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, CHOICE: hand},
        capture_output=True,
        text=True,
        check=True,
    )
    return Path(done.stdout.strip().splitlines()[-1])


def written(tmp_path: Path, hand: str, thumb: str = "thumb") -> Path:
    folder = tmp_path / "mine"
    folder.mkdir()
    file, _ = import_hand(urdf_of(hand), "mine", thumb)
    (folder / FILE).write_text(yaml.safe_dump(file, sort_keys=False))
    return folder


@pytest.mark.parametrize("name", ["dexhand_pro", "dexhand_021", "allegro"])
def test_the_imported_hand_moves_like_the_one_it_came_from(name: str, tmp_path: Path) -> None:
    known, found = load_hand(name), load_hand(written(tmp_path, name))
    assert found.fingers == known.fingers and found.driven_joints == known.driven_joints
    np.testing.assert_allclose(found.lower, known.lower, atol=2e-3)
    np.testing.assert_allclose(found.upper, known.upper, atol=2e-3)
    rng = np.random.default_rng(0)
    tips = []
    for hand in (known, found):
        joints = known.expand(known.reduce(rng.uniform(known.lower, known.upper, (50, known.joint_count))))
        rng = np.random.default_rng(0)
        tips.append(hand.fingertips(joints).reshape(-1, 3))
    # The two may stand differently on their flange; one rigid motion brings all tips of all postures together.
    a, b = (points - points.mean(axis=0) for points in tips)
    turn, _ = Rotation.align_vectors(a, b)
    assert np.linalg.norm(a - turn.apply(b), axis=1).max() < 1e-4


@pytest.mark.parametrize("name", ["dexhand_021", "allegro"])
def test_the_imported_hand_grasps_at_once(name: str, tmp_path: Path) -> None:
    folder = written(tmp_path, name)
    found, known = load_hand(folder), load_hand(name)
    assert (
        approach_of(found) == pytest.approx(approach_of(known), abs=0.3)
        and found.grasp.level_pinch is not None
    )
    assert grasps_of_a_block(folder) > 0


def test_fingers_that_count_down_and_pads_beside_their_tip_change_nothing(tmp_path: Path) -> None:
    known, _ = import_hand(urdf_of("dexhand_pro"), "mine")
    tree = ElementTree.parse(urdf_of("dexhand_pro"))
    pad = "<joint name='{0}' type='fixed'><parent link='{1}'/><child link='{0}_link'/><origin xyz='0 0.01 0'/></joint>"
    for joint in tree.getroot().findall("joint[@type='revolute']"):
        axis, limit = joint.find("axis"), joint.find("limit")
        assert axis is not None and limit is not None
        if joint.get("name", "").endswith("joint1"):
            continue
        axis.set("xyz", " ".join(str(-float(v)) for v in axis.get("xyz", "").split()))
        lower, upper = float(limit.get("lower", 0)), float(limit.get("upper", 0))
        limit.set("lower", str(-upper)), limit.set("upper", str(-lower))
    for parent, name in (
        ("thumb_distal", "pad"),
        ("pad_link", "sensor"),
        ("thumb_distal", "nail"),
        ("nail_link", "x"),
    ):
        tree.getroot().append(ElementTree.fromstring(pad.format(name, parent)))
    tree.write(tmp_path / "down.urdf")
    found, told = import_hand(tmp_path / "down.urdf", "mine")
    assert found == known
    assert any("counted the other way round" in line and "thumb_joint2" in line for line in told)


def test_limits_that_a_urdf_leaves_out_are_those_of_its_format(tmp_path: Path) -> None:
    known, _ = import_hand(urdf_of("dexhand_pro"), "mine")
    path, text = tmp_path / "short.urdf", urdf_of("dexhand_pro").read_text()
    path.write_text(text.replace('<limit lower="0" ', "<limit "))
    assert '<limit upper="' in path.read_text() and import_hand(path, "mine")[0] == known
    path.write_text(
        text.replace('name="ring_joint1" type="revolute"', 'name="ring_joint1" type="continuous"')
    )
    joint = import_hand(path, "mine")[0]["fingers"]["ring"]["joints"][0]
    assert (joint["lower"], joint["upper"]) == (-np.pi, np.pi)


def test_a_first_joint_that_turns_a_short_finger_stays_the_first(tmp_path: Path) -> None:
    text = urdf_of("dexhand_pro").read_text()
    place = text.index('<joint name="thumb_joint2"')
    path = tmp_path / "short.urdf"
    path.write_text(text[:place] + text[place:].replace('type="revolute"', 'type="fixed"', 1))
    file, _ = import_hand(path, "mine", "thumb_")
    joints = file["fingers"]["thumb"]["joints"]
    assert joints[1] == {"at": 0.0} and all("lower" in joints[k] for k in (0, 2, 3))


def approach_of(hand: HandModel) -> float:
    return float(np.arccos(hand.T_base_tcp[2, 2]))


def test_a_hand_that_cannot_pinch_is_refused(tmp_path: Path) -> None:
    urdf = tmp_path / "fork.urdf"
    joint = (
        '<joint name="{0}" type="revolute"><parent link="palm"/><child link="{0}_link"/><axis xyz="0 1 0"/>'
    )
    joint += '<origin xyz="{1} 0 0"/><limit lower="0" upper="0.1" effort="1"/></joint><link name="{0}_link"/>'
    fingers = "".join(joint.format(name, x) for name, x in (("a", 0.0), ("b", 0.3)))
    urdf.write_text(f'<robot name="fork"><link name="palm"/>{fingers}</robot>')
    with pytest.raises(DgsError, match="no hand that grasps: thumb and fingers meet nowhere"):
        import_hand(urdf, "fork")


def test_the_thumb_is_the_finger_that_bends_unlike_the_others(tmp_path: Path) -> None:
    file, told = import_hand(urdf_of("dexhand_pro"), "mine")
    assert list(file["fingers"]) == ["thumb", "index", "middle", "ring", "little"]
    assert "thumb is the finger that begins at thumb_joint1" in told
    assert any("guesses" in line for line in told)


def test_the_command_writes_once(tmp_path: Path) -> None:
    call = [
        sys.executable,
        "-m",
        "dgs_description.hand_import",
        str(urdf_of("allegro")),
        str(tmp_path / "dexhand_021"),
    ]
    first = subprocess.run(call, capture_output=True, text=True, timeout=60)
    assert first.returncode == 0 and "hand.yaml" in first.stdout, first.stderr
    assert load_hand(tmp_path / "dexhand_021").finger_count == 4
    again = subprocess.run(call, capture_output=True, text=True, timeout=60)
    assert again.returncode == 1 and "not overwritten" in again.stderr


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine").write_text("a file")
    monkeypatch.setattr(hand_import, "import_hand", lambda *_: ({}, []))
    monkeypatch.setattr(sys, "argv", ["hand_import", "hand.urdf", str(tmp_path / "mine")])
    with pytest.raises(SystemExit, match=r"mine.hand\.yaml cannot be written"):
        hand_import.main()


@pytest.mark.parametrize(
    ("mimic", "words"),
    [
        ("<mimic joint='joint_2' multiplier='1.0' offset='0.1'/>", "with an offset"),
        ("<mimic joint='elbow'/>", "follows 'elbow', which is no joint of a finger"),
    ],
)
def test_couplings_that_cannot_be_kept_are_refused(mimic: str, words: str, tmp_path: Path) -> None:
    text = urdf_of("allegro").read_text()
    path, place = tmp_path / "hand.urdf", text.index("</joint>", text.index('type="revolute"'))
    path.write_text(text[:place] + mimic + text[place:])
    with refused(ErrorCode.PARAMETER_INVALID, words):
        import_hand(path, "mine")


def test_a_finger_of_which_nothing_says_where_it_points_is_named(tmp_path: Path) -> None:
    joint = "<joint name='{0}{1}' type='revolute'><parent link='{2}'/><child link='{0}{1}'/><axis xyz='{3}'/></joint>"
    fingers = (joint.format(f, 1, "palm", "1 0 0") + joint.format(f, 2, f"{f}1", "0 1 0") for f in "ab")
    (tmp_path / "hand.urdf").write_text(f"<robot>{''.join(fingers)}</robot>")
    with refused(ErrorCode.PARAMETER_INVALID, "the finger of a1 points: .* fingertip frame behind a2"):
        import_hand(tmp_path / "hand.urdf", "mine")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("no xml", "cannot be imported"),
        (
            "<robot><joint name='j' type='prismatic'><parent link='a'/><child link='b'/></joint></robot>",
            "the joint j is prismatic",
        ),
        ("<robot><link name='a'/></robot>", "0 root links"),
        (
            "<robot><joint name='j' type='fixed'><parent link='a'/><child link='b'/></joint></robot>",
            "0 fingers, the suite takes two to five",
        ),
    ],
)
def test_what_is_no_hand_is_refused(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "hand.urdf"
    path.write_text(text)
    with refused(ErrorCode.PARAMETER_INVALID, words):
        import_hand(path, "mine")


def test_the_stance_of_a_folder_beside_one_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shipped = Path(str(files("dgs_description"))) / "hands" / "dexhand_021"
    shutil.copytree(shipped, tmp_path / "dexhand_021")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["hand_stance", "dexhand_021"])
    hand_stance.main()
    assert yaml.safe_load(capsys.readouterr().out)["approach"] == pytest.approx(np.pi / 3, abs=0.1)
    monkeypatch.setattr(sys, "argv", ["hand_stance", "nobody's"])
    with pytest.raises(SystemExit, match="^11: no hand"):
        hand_stance.main()
    far = yaml.safe_load((tmp_path / "dexhand_021" / FILE).read_text())
    far["fingers"]["thumb"]["place"][0] = 0.5
    (tmp_path / "dexhand_021" / FILE).write_text(yaml.safe_dump(far, sort_keys=False))
    monkeypatch.setattr(sys, "argv", ["hand_stance", "dexhand_021"])
    with pytest.raises(SystemExit, match="^dexhand_021: thumb and fingers meet nowhere"):
        hand_stance.main()
