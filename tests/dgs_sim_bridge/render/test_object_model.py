import json
from pathlib import Path

import numpy as np
import pytest

from dgs_description.errors import DgsError, ErrorCode
from dgs_sim_bridge.render.object_model import find_catalogue, from_parts, save_catalogue

CUBE = np.array([(x, y, z) for x in (0, 0.04) for y in (0, 0.04) for z in (0, 0.04)])


def test_the_repositorys_novel_objects_are_found() -> None:
    objects = find_catalogue("novel")
    assert len(objects) >= 40
    assert {o.shape_class for o in objects} == {"cuboid", "cylinder", "stick", "sphere", "bowl"}


def test_the_objects_of_the_dataset_are_those_for_training() -> None:
    train, novel = find_catalogue("train"), find_catalogue("novel")
    assert len(train) >= 307
    assert not {o.name for o in train} & {o.name for o in novel}


def test_environment_and_parameter_choose_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_catalogue(tmp_path / "novel_objects.npz", [from_parts("cube", "cuboid", "cube", [CUBE], 0.1)])
    assert [o.name for o in find_catalogue("novel", str(tmp_path))] == ["cube"]
    monkeypatch.setenv("DGS_MODELS_DIR", str(tmp_path))
    assert [o.name for o in find_catalogue("novel")] == ["cube"]


def test_a_file_or_a_mesh_folder_is_taken_by_its_path(tmp_path: Path) -> None:
    save_catalogue(tmp_path / "mine.npz", [from_parts("cube", "cuboid", "cube", [CUBE], 0.1)])
    assert [o.name for o in find_catalogue(str(tmp_path / "mine.npz"))] == ["cube"]
    lines = ["o part"] + [f"v {x} {y} {z}" for x, y, z in CUBE - 0.02]
    faces = ["f 1 2 4", "f 1 4 3", "f 5 7 8", "f 5 8 6"]
    (tmp_path / "cube.obj").write_text("\n".join(lines + faces) + "\n")
    record = {
        "name": "box",
        "shape_class": "cuboid",
        "mass_kg": 0.2,
        "files": {"visual": "cube.obj", "collision": "cube.obj"},
    }
    (tmp_path / "manifest.json").write_text(json.dumps({"objects": [record]}))
    (box,) = find_catalogue(str(tmp_path))
    assert (box.name, box.mass, len(box.parts), len(box.faces)) == ("box", 0.2, 1, 4)


@pytest.mark.parametrize("name", ["novel", "household", "train"])
def test_missing_catalogue_is_named(name: str, tmp_path: Path) -> None:
    with pytest.raises(DgsError, match=str(tmp_path)) as caught:
        find_catalogue(name, str(tmp_path))
    assert caught.value.code == ErrorCode.SIM_CATALOGUE


def test_missing_folder_and_file_are_named() -> None:
    with pytest.raises(DgsError, match="/no/such/models"):
        find_catalogue("novel", "/no/such/models")
    with pytest.raises(DgsError, match="/no/such/catalogue"):
        find_catalogue("/no/such/catalogue")
