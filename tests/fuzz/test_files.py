"""Files that anybody may hand in: read, or refused with a code; never another exception, never code that runs."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given

from dgs_description.arm_kinematics import LINKS, read_kinematics
from dgs_description.cell import load_cell
from dgs_description.errors import DgsError
from dgs_description.hand_file import HANDS, load_hand
from dgs_grasp_planner.contact.shape_completion import completion_net as shape_net
from dgs_grasp_planner.contact.shape_completion import loaded_net as loaded_shape_net
from dgs_grasp_planner.network.config import PRESETS
from dgs_grasp_planner.network.dgs_net import DGSNet
from dgs_grasp_planner.network.weights import file_sha256, load_network, save_network
from dgs_hand_driver.dbc_codec import DbcCodec
from dgs_learning.prediction.cloud_file import read_cloud
from dgs_perception.bags import BagSource
from dgs_perception.calibrate_hand_eye import read_samples
from dgs_perception.completion import DepthCompletion, completion_net
from dgs_sim_bridge.render.object_model import from_parts, load_catalogue, save_catalogue
from tests.fuzz.cases import damaged, fuzz
from tests.support.environment import REPO_ROOT

CUBE = np.array([(x, y, z) for x in (0, 0.04) for y in (0, 0.04) for z in (0, 0.04)])
OBJ = (
    "o part\n"
    + "".join(f"v {x} {y} {z}\n" for x, y, z in CUBE - 0.02)
    + "f 1 2 4\nf 1 4 3\nf 5 7 8\nf 5 8 6\n"
)
MANIFEST = {
    "objects": [
        {
            "name": "box",
            "shape_class": "cuboid",
            "mass_kg": 0.2,
            "files": {"visual": "a.obj", "collision": "a.obj"},
        }
    ]
}
POSE = "{position: [0.3, 0.0, 0.4], quaternion_xyzw: [1.0, 0.0, 0.0, 0.0]}"
SAMPLES = f"samples:\n  - T_base_tool0: {POSE}\n    T_camera_board: {POSE}\n"
CELL = """
table_height: -0.3
home: [0, -1.9, 1.7, 0, 0, 0]
camera_position: [0.77, 0.0, 0.68]
camera_quaternion_xyzw: [0.6861, 0.6861, -0.1711, -0.1711]
optical_frame: left
"""
PLACE = "{x: 0.0, y: 0.0, z: 0.15, roll: 0.0, pitch: 1e-3, yaw: 0.0}"
CALIBRATION = "kinematics:\n" + "".join(f"  {link}: {PLACE}\n" for link in LINKS) + "  hash: calib_1\n"
BAG = REPO_ROOT / "tests/data/table_depth"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Good files of every kind."""
    folder = tmp_path_factory.mktemp("files")
    save_catalogue(folder / "cubes.npz", [from_parts("cube", "cuboid", "cube", [CUBE], 0.1)])
    np.save(folder / "cloud.npy", np.full((30, 3), 0.1, np.float32))
    np.savez_compressed(folder / "cloud.npz", points=np.full((30, 3), 0.1, np.float32))
    (folder / "samples.yaml").write_text(SAMPLES)
    (folder / "meshes").mkdir()
    (folder / "meshes/a.obj").write_text(OBJ)
    (folder / "meshes/manifest.json").write_text(json.dumps(MANIFEST))
    save_network(DGSNet(PRESETS["tiny"]), folder, "net")
    completion_net().save(folder / "completion.pt", {})
    shape_net().save(folder / "shapes.pt", {})
    shutil.copytree(BAG, folder / "bag")
    (folder / "cell.yaml").write_text(CELL)
    (folder / "calibration.yaml").write_text(CALIBRATION)
    shutil.copytree(HANDS / "allegro", folder / "allegro")
    shutil.copy(REPO_ROOT / "dgs_hand_driver/dgs_hand_driver/dexhand.dbc", folder)
    return folder


def _meshes(file: Path) -> None:
    load_catalogue(file.parent)


def _hand(file: Path) -> None:
    load_hand(file.parent)


def _network(file: Path) -> None:
    load_network(file.parent, "net")


def _bag(file: Path) -> None:
    bag = BagSource(file.parent)
    try:
        for message in islice(bag.messages(), 3):
            assert message.topic
    finally:
        bag.close()


READERS: dict[str, Callable[[Path], object]] = {
    "cubes.npz": load_catalogue,
    "cloud.npy": read_cloud,
    "cloud.npz": read_cloud,
    "samples.yaml": read_samples,
    "cell.yaml": load_cell,
    "calibration.yaml": read_kinematics,
    "allegro/hand.yaml": _hand,
    "dexhand.dbc": DbcCodec,
    "meshes/manifest.json": _meshes,
    "meshes/a.obj": _meshes,
    "net.json": _network,
    "net.pt": _network,
    "completion.pt": DepthCompletion,
    "shapes.pt": loaded_shape_net,
    "bag/metadata.yaml": _bag,
    "bag/table_depth.mcap": _bag,
}


@pytest.mark.parametrize("name", READERS)
def test_the_good_file_is_read(folder: Path, name: str) -> None:
    READERS[name](folder / name)


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file_is_read_or_refused(folder: Path, name: str) -> None:
    good = (folder / name).read_bytes()

    @fuzz
    @given(damaged(good))
    def try_it(content: bytes) -> None:
        (folder / name).write_bytes(content)
        try:
            READERS[name](folder / name)
        except DgsError as error:
            assert error.message

    try:
        try_it()
    finally:
        (folder / name).write_bytes(good)


def test_weights_cannot_run_code(tmp_path: Path) -> None:
    class Payload:
        def __reduce__(self) -> tuple:
            return Path.mkdir, (tmp_path / "mark",)

    info = save_network(DGSNet(PRESETS["tiny"]), tmp_path, "net")
    torch.save({"hostile": Payload()}, tmp_path / "net.pt")
    text = (tmp_path / "net.json").read_text()
    (tmp_path / "net.json").write_text(text.replace(info.sha256, file_sha256(tmp_path / "net.pt")))
    with pytest.raises(DgsError, match="weights_only|Weights only"):
        load_network(tmp_path, "net")
    assert not (tmp_path / "mark").exists()
