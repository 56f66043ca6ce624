import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_sim_bridge.render.object_model import catalogue_to_arrays, find_catalogue, from_parts, save_catalogue
from tests.support.refused import refused

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


def test_materials_are_kept_and_leave_files_of_opaque_objects_as_they_were(tmp_path: Path) -> None:
    cube = from_parts("cube", "cuboid", "cube", [CUBE], 0.1)
    assert "material" not in catalogue_to_arrays([cube])
    save_catalogue(tmp_path / "mine.npz", [cube, replace(cube, name="jar", material="glass")])
    assert [o.material for o in find_catalogue(str(tmp_path / "mine.npz"))] == ["opaque", "glass"]
    save_catalogue(tmp_path / "mine.npz", [replace(cube, material="jelly")])
    with refused(ErrorCode.SIM_CATALOGUE, "jelly"):
        find_catalogue(str(tmp_path / "mine.npz"))


def test_a_mesh_of_many_corners_survives_its_file(tmp_path: Path) -> None:
    cube = from_parts("cube", "cuboid", "cube", [CUBE], 0.1)
    scan = replace(cube, vertices=np.tile(cube.vertices, (8193, 1)), faces=cube.faces + 8 * 8192)
    save_catalogue(tmp_path / "mine.npz", [scan])
    (read,) = find_catalogue(str(tmp_path / "mine.npz"))
    np.testing.assert_array_equal(read.faces, scan.faces)
    assert CUBE_ARRAYS["faces"].dtype == np.uint16, "what fits there is as it was, and so are the hashes"


@pytest.mark.parametrize("name", ["novel", "household", "train"])
def test_missing_catalogue_is_named(name: str, tmp_path: Path) -> None:
    with refused(ErrorCode.SIM_CATALOGUE, str(tmp_path)):
        find_catalogue(name, str(tmp_path))


CUBE_ARRAYS = catalogue_to_arrays([from_parts("cube", "cuboid", "cube", [CUBE], 0.1)])


def damaged(**changes: np.ndarray | None) -> bytes:
    """A catalogue of one cube with some of its arrays changed, or left out where they are None."""
    buffer = io.BytesIO()
    arrays = {**CUBE_ARRAYS, **changes}
    np.savez_compressed(buffer, **{name: array for name, array in arrays.items() if array is not None})
    return buffer.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"just text\n",
        b"PK\x03\x04 no zip",
        damaged()[:200],
        damaged(mass=None),
        damaged(mass=np.array([np.nan])),
        damaged(mass=np.array([0.1, 0.2])),
        damaged(shape_class=np.array(["mug"])),
        damaged(faces=np.array([[0, 1, 99]])),
        damaged(faces=np.zeros((0, 3), int), face_count=np.array([0])),
        damaged(vertex_count=np.array([-8])),
        damaged(vertex_count=np.array([4])),
        damaged(part_vertices=np.zeros((8, 3))),
        damaged(part_vertices=1000 * CUBE_ARRAYS["part_vertices"]),
        damaged(part_count=np.array([2])),
        damaged(name=np.array([{"an": "object"}], dtype=object)),
        damaged(name=np.array([5])),
        damaged(
            **{key: np.concatenate([array, array]) for key, array in CUBE_ARRAYS.items()}
        ),  # one name, two cubes
    ],
)
def test_a_file_of_another_kind_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "other.npz"
    path.write_bytes(content)
    with refused(ErrorCode.SIM_CATALOGUE, r"other\.npz|object ('cube'|5)"):
        find_catalogue(str(path))


@pytest.mark.parametrize(
    "name", ["/etc/passwd", "/dev/zero", "x" * 5000, "~nobody_of_this_name/x", "a\0b", ""]
)
def test_a_name_of_something_else_is_refused(name: str) -> None:
    with refused(ErrorCode.SIM_CATALOGUE):
        find_catalogue(name)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"objects": [{}]}', '{"objects": [{"name": "a", "files": 3}]}']
)
def test_a_folder_with_another_manifest_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "manifest.json").write_text(text)
    with refused(ErrorCode.SIM_CATALOGUE):
        find_catalogue(str(tmp_path))


def test_missing_folder_and_file_are_named() -> None:
    with refused(ErrorCode.SIM_CATALOGUE, "/no/such/catalogue"):
        find_catalogue("/no/such/catalogue")
