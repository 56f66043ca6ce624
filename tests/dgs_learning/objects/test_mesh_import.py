"""Mesh files of all kinds into the import format, and the format through the simulator."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from dgs_description.errors import DgsError
from dgs_description.frames import transform
from dgs_learning.objects.decomposition import convex_parts
from dgs_learning.objects.mesh_import import (
    MAX_FACES,
    ImportSettings,
    find_meshes,
    guess_shape_class,
    import_mesh,
    names_of,
    read_mesh,
    write_manifest,
)
from dgs_sim_bridge.render.object_model import load_catalogue
from dgs_sim_bridge.world.scenes import SettlingTable
from tests.support.commands import dgs


def l_shape() -> trimesh.Trimesh:
    """An L of two bars: concave, volume 90 cm^3."""
    outline = [(0, 0), (80, 0), (80, 30), (30, 30), (30, 70), (0, 70)]
    triangles = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    low = np.array([(x, y, 0) for x, y in outline], float)
    vertices = np.concatenate([low, low + (0, 0, 25)]) / 1000
    faces = [(c, b, a) for a, b, c in triangles] + [(a + 6, b + 6, c + 6) for a, b, c in triangles]
    for k in range(6):
        n = (k + 1) % 6
        faces += [(k, n, n + 6), (k, n + 6, k + 6)]
    return trimesh.Trimesh(vertices, faces)


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "glb"])
def test_every_format_gives_the_same_object(tmp_path: Path, suffix: str) -> None:
    box = trimesh.creation.box(extents=(40, 60, 80))
    box.apply_translation((500, -20, 7))
    if suffix == "glb":  # glTF has y up
        box.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, (1, 0, 0)))
    path = tmp_path / f"box.{suffix}"
    box.export(path)
    record = import_mesh(path, "box", tmp_path / "out", ImportSettings(scale=0.001))
    write_manifest(tmp_path / "out", record)
    (model,) = load_catalogue(tmp_path / "out")
    assert np.allclose(model.bounds, [[-0.02, -0.03, -0.04], [0.02, 0.03, 0.04]], atol=1e-5), (
        "metres, centred, z up"
    )
    assert model.shape_class == "cuboid" and len(model.parts) == 1
    assert model.mass == pytest.approx(400 * 0.04 * 0.06 * 0.08, rel=1e-3)
    normals = np.cross(
        *(model.vertices[model.faces[:, k]] - model.vertices[model.faces[:, 0]] for k in (1, 2))
    )
    assert ((normals * model.vertices[model.faces].mean(1)).sum(1) > 0).all(), "faces look outwards"


def test_a_scene_of_several_pieces_becomes_one_object(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(trimesh.creation.box(extents=(0.03, 0.03, 0.03)))
    scene.add_geometry(
        trimesh.creation.box(extents=(0.03, 0.03, 0.03)), transform=transform(position=(0.025, 0, 0))
    )
    scene.export(tmp_path / "pair.glb")
    mesh = read_mesh(tmp_path / "pair.glb", ImportSettings())
    assert np.allclose(np.sort(mesh.extents), [0.03, 0.03, 0.055], atol=1e-6)


def test_a_face_without_area_leaves_nothing_behind(tmp_path: Path) -> None:
    box = trimesh.creation.box(extents=(0.04, 0.05, 0.06))
    corners, far = [*box.vertices, (0.3, 0.3, 0.3)], (8, 8, 8)
    trimesh.Trimesh(corners, [*box.faces[1:], far], process=False).export(tmp_path / "open.obj")
    mesh = read_mesh(tmp_path / "open.obj", ImportSettings())
    assert np.allclose(np.ptp(mesh.vertices, axis=0), (0.04, 0.05, 0.06))


def test_a_concave_mesh_is_cut_into_parts_that_fill_it() -> None:
    mesh = l_shape()
    assert mesh.is_volume and mesh.volume == pytest.approx(90e-6, rel=0.01)
    parts = convex_parts(mesh, threshold=0.05, max_hulls=16)
    assert 2 <= len(parts) <= 6
    volume = sum(trimesh.Trimesh(p).convex_hull.volume for p in parts)
    assert volume == pytest.approx(mesh.volume, rel=0.06), "the notch of the L is filled"


def test_fine_meshes_are_thinned_out_and_keep_their_shape(tmp_path: Path) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.03)
    ball.export(tmp_path / "ball.ply")
    record = import_mesh(tmp_path / "ball.ply", "ball", tmp_path / "out", ImportSettings(mass=0.1))
    write_manifest(tmp_path / "out", record)
    (model,) = load_catalogue(tmp_path / "out")
    assert record["source_faces"] > 20_000 and len(model.faces) <= MAX_FACES
    assert np.abs(np.linalg.norm(model.vertices, axis=1) - 0.03).max() < 3e-4
    assert max(len(part) for part in model.parts) <= 64
    assert model.shape_class == "sphere" and model.mass == 0.1


def test_imported_objects_rest_on_the_table(tmp_path: Path) -> None:
    l_shape().export(tmp_path / "ell.stl")
    record = import_mesh(tmp_path / "ell.stl", "ell", tmp_path, ImportSettings())
    write_manifest(tmp_path, record)
    (model,) = load_catalogue(tmp_path)
    with SettlingTable() as table:
        table.add(model, transform(position=(0, 0, 0.003 - model.vertices[:, 2].min())))
        table.step(300)
        (T,) = table.poses()
    lowest = float((model.vertices @ T[:3, :3].T + T[:3, 3])[:, 2].min())
    assert -0.002 < lowest < 0.003 and T[2, 2] > 0.99


@pytest.mark.parametrize(
    ("extents", "fill", "solidity", "wanted"),
    [
        ((0.04, 0.07, 0.10), 1.0, 1.0, "cuboid"),
        ((0.06, 0.06, 0.12), np.pi / 4, 1.0, "cylinder"),
        ((0.03, 0.08, 0.08), np.pi / 4, 1.0, "cylinder"),
        ((0.02, 0.02, 0.16), 1.0, 1.0, "stick"),
        ((0.06, 0.06, 0.07), np.pi / 6, 1.0, "sphere"),
        ((0.05, 0.12, 0.12), 0.7, 0.2, "bowl"),
    ],
)
def test_classes_of_plain_shapes(extents: tuple, fill: float, solidity: float, wanted: str) -> None:
    hull = float(np.prod(extents)) * fill
    assert guess_shape_class(extents, hull * solidity, hull) == wanted


def test_bad_input_is_refused_in_a_sentence(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("no mesh")
    (tmp_path / "broken.stl").write_text("no mesh")
    trimesh.creation.box(extents=(40, 60, 80)).export(tmp_path / "millimetres.stl")
    flat = trimesh.creation.box(extents=(0.05, 0.05, 1e-6))
    flat.export(tmp_path / "flat.stl")
    flat.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 1, 0))).export(
        tmp_path / "leaning.stl"
    )
    line = trimesh.Trimesh([(0, 0, 0.05 * k) for k in range(4)], [(0, 1, 2), (1, 2, 3)] * 2, process=False)
    line.export(tmp_path / "line.stl")
    (tmp_path / "empty").mkdir()
    for path, words in (("note.txt", "not one of"), ("none.obj", "does not exist"), ("empty", "holds no")):
        with pytest.raises(DgsError, match=words):
            find_meshes([tmp_path / path])
    for path, words in (
        ("broken.stl", "cannot be read|faces"),
        ("millimetres.stl", "0.001"),
        ("flat.stl", "flat"),
        ("leaning.stl", "flat"),
        ("line.stl", "flat"),
    ):
        with pytest.raises(DgsError, match=words):
            read_mesh(tmp_path / path, ImportSettings())
    for bad, words in (
        ({"density": -1.0}, "density"),
        ({"shape_class": "cone"}, "cone"),
        ({"up": "x"}, "y or z"),
        ({"threshold": 0.0}, "threshold"),
        ({"threshold": float("nan")}, "threshold"),
    ):
        with pytest.raises(DgsError, match=words):
            ImportSettings(**bad)


def test_names_are_told_apart_by_their_folder() -> None:
    assert names_of([Path("/a/cup/mesh.obj"), Path("/a/jug/mesh.obj")]) == ["cup_mesh", "jug_mesh"]
    assert names_of([Path("/a/red cup@1.obj")]) == ["red_cup_1"]
    with pytest.raises(DgsError, match="cup_mesh"):
        names_of([Path("/a/cup/mesh.obj"), Path("/b/cup/mesh.obj")])


def test_command_adds_to_a_folder_and_refuses_in_a_sentence(tmp_path: Path) -> None:
    trimesh.creation.cylinder(radius=0.03, height=0.09).export(tmp_path / "can.stl")
    trimesh.creation.box(extents=(0.04, 0.05, 0.06)).export(tmp_path / "box.obj")
    out = tmp_path / "out"
    for name, words in (("can.stl", []), ("box.obj", ["--shape-class", "stick"])):
        dgs(["import", str(tmp_path / name), "--out", str(out), *words])
    classes = {model.name: model.shape_class for model in load_catalogue(out)}
    assert classes == {"can": "cylinder", "box": "stick"}
    trimesh.creation.box(extents=(0.04, 0.05, 0.06)).export(out / "more.stl")
    assert [file.name for file in find_meshes([out])] == ["more.stl"], "not what it has imported"
    above = find_meshes([tmp_path, tmp_path / "can.stl"])
    assert sorted(file.name for file in above) == ["box.obj", "can.stl", "more.stl"], (
        "nor from above, and once"
    )
    box = str(tmp_path / "box.obj")
    for text in ("{", "[]", "{}"):
        (out / "manifest.json").write_text(text)
        assert "lists no objects" in dgs(["import", box, "--out", str(out)], 2).output
