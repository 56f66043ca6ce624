"""Objects of the simulated world, and their catalogue files.

An object has convex parts for contact, a mesh for the camera, mass and friction.

A catalogue is one `.npz` file (no pickles) or a folder with `manifest.json` (import format, one visual and one convex
collision mesh per object). Frame of an object: origin at its centre of mass, metres.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.paths import models_dir

SHAPE_CLASSES = ("cuboid", "cylinder", "stick", "sphere", "bowl")
CATALOGUES = {"novel": "novel_objects.npz", "household": "household_objects.npz", "train": "dataset.npz"}
"""Files of the named catalogues in the models folder; the dataset holds the objects that it is about."""


@dataclass(frozen=True)
class ObjectModel:
    """One rigid object.

    Attributes:
        name: unique in its catalogue.
        shape_class: one of `SHAPE_CLASSES`.
        family: what it looks like, e.g. "bottle".
        mass: [kg].
        parts: convex parts, each (V, 3) vertices [m].
        vertices: (V, 3) of the visual mesh [m].
        faces: (F, 3) indices of the visual mesh, counter-clockwise from outside.
        friction: lateral friction coefficient.
    """

    name: str
    shape_class: str
    family: str
    mass: float
    parts: tuple[NDArray[np.float32], ...]
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    friction: float = 1.0

    def scaled(self, factor: float) -> ObjectModel:
        """The object with all lengths times `factor`, mass times `factor` cubed, name suffixed with the factor."""
        return replace(
            self,
            name=f"{self.name}@{factor:.2f}",
            mass=self.mass * factor**3,
            parts=tuple((part * factor).astype(np.float32) for part in self.parts),
            vertices=(self.vertices * factor).astype(np.float32),
        )

    @property
    def bounds(self) -> NDArray[np.float32]:
        """(2, 3) lower and upper corner of the mesh's box [m]."""
        return np.stack([self.vertices.min(0), self.vertices.max(0)])


def from_parts(
    name: str, shape_class: str, family: str, parts: Sequence[NDArray], mass: float
) -> ObjectModel:
    """Build an object of a mass [kg] from convex parts, the hulls of (V, 3) points each [m].

    The mesh is the parts' hulls, the origin moves to the centre of mass.
    """
    hulls = [ConvexHull(np.asarray(part, dtype=np.float64)) for part in parts]
    meshes = [_hull_mesh(hull) for hull in hulls]
    volumes = np.array([hull.volume for hull in hulls])
    centroids = np.array([_centroid(vertices, faces) for vertices, faces in meshes])
    centre = (volumes[:, None] * centroids).sum(0) / volumes.sum()
    starts = np.cumsum([0, *(len(corners) for corners, _ in meshes)])
    vertices = [corners - centre for corners, _ in meshes]
    faces = [triangles + start for (_, triangles), start in zip(meshes, starts[:-1], strict=True)]
    return ObjectModel(
        name=name,
        shape_class=shape_class,
        family=family,
        mass=float(mass),
        parts=tuple(v.astype(np.float32) for v in vertices),
        vertices=np.concatenate(vertices).astype(np.float32),
        faces=np.concatenate(faces).astype(np.int32),
    )


def _hull_mesh(hull: ConvexHull) -> tuple[NDArray, NDArray]:
    used = np.unique(hull.simplices)
    index = np.full(len(hull.points), -1)
    index[used] = np.arange(len(used))
    vertices, faces = hull.points[used], index[hull.simplices]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def _centroid(vertices: NDArray, faces: NDArray) -> NDArray:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    return (volume[:, None] * (a + b + c)).sum(0) / (4 * volume.sum())


def save_catalogue(path: Path, objects: Sequence[ObjectModel]) -> None:
    """Write objects to one compressed `.npz`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, allow_pickle=False, **catalogue_to_arrays(objects))


def catalogue_to_arrays(objects: Sequence[ObjectModel]) -> dict[str, NDArray]:
    """The arrays that `save_catalogue` writes."""
    return {
        "name": np.array([o.name for o in objects]),
        "shape_class": np.array([o.shape_class for o in objects]),
        "family": np.array([o.family for o in objects]),
        "mass": np.array([o.mass for o in objects], dtype=np.float32),
        "friction": np.array([o.friction for o in objects], dtype=np.float32),
        "vertices": np.concatenate([o.vertices for o in objects]).astype(np.float32),
        "faces": np.concatenate([o.faces for o in objects]).astype(np.uint16),
        "vertex_count": np.array([len(o.vertices) for o in objects], dtype=np.int32),
        "face_count": np.array([len(o.faces) for o in objects], dtype=np.int32),
        "part_vertices": np.concatenate([part for o in objects for part in o.parts]).astype(np.float32),
        "part_vertex_count": np.array([len(part) for o in objects for part in o.parts], dtype=np.int32),
        "part_count": np.array([len(o.parts) for o in objects], dtype=np.int32),
    }


def find_catalogue(name: str, models: Path | str = "") -> list[ObjectModel]:
    """Load a catalogue by name (of `CATALOGUES`) from a models folder (see `models_dir`), or by path.

    Raises:
        DgsError: as `load_catalogue` and `models_dir`.
    """
    if name in CATALOGUES:
        return load_catalogue(models_dir(models) / CATALOGUES[name])
    return load_catalogue(Path(name).expanduser())


def load_catalogue(path: Path) -> list[ObjectModel]:
    """Read a catalogue: a `.npz` written by `save_catalogue`, or a folder with `manifest.json`.

    Raises:
        DgsError: SIM_CATALOGUE: nothing is there, or it is neither of the two.
    """
    path = Path(path)
    if path.is_dir():
        return _load_manifest(path)
    if not path.is_file():
        raise DgsError(ErrorCode.SIM_CATALOGUE, f"no object catalogue at {path}")
    with np.load(path, allow_pickle=False) as data:
        return catalogue_from_arrays(data)


def catalogue_from_arrays(data) -> list[ObjectModel]:
    """Objects from the arrays that `save_catalogue` writes (also used by the dataset file)."""
    vertices = np.split(data["vertices"], np.cumsum(data["vertex_count"])[:-1])
    faces = np.split(data["faces"].astype(np.int32), np.cumsum(data["face_count"])[:-1])
    parts = np.split(data["part_vertices"], np.cumsum(data["part_vertex_count"])[:-1])
    first = np.concatenate([[0], np.cumsum(data["part_count"])])
    columns = [data[key].tolist() for key in ("name", "shape_class", "family", "mass")]
    own = (tuple(parts[a:b]) for a, b in pairwise(first))
    rows = zip(*columns, own, vertices, faces, data["friction"].tolist(), strict=True)
    return [ObjectModel(*row) for row in rows]


def _load_manifest(folder: Path) -> list[ObjectModel]:
    import trimesh  # only mesh folders need it

    manifest = folder / "manifest.json"
    if not manifest.is_file():
        raise DgsError(ErrorCode.SIM_CATALOGUE, f"{folder} has no manifest.json")
    objects = []
    for record in json.loads(manifest.read_text())["objects"]:
        visual = trimesh.load(folder / record["files"]["visual"], force="mesh", process=False)
        objects.append(
            ObjectModel(
                name=record["name"],
                shape_class=record["shape_class"],
                family=record.get("family", record["name"]),
                mass=float(record["mass_kg"]),
                parts=tuple(_hull_groups(folder / record["files"]["collision"])),
                vertices=np.asarray(visual.vertices, dtype=np.float32),
                faces=np.asarray(visual.faces, dtype=np.int32),
            )
        )
    return objects


def _hull_groups(path: Path) -> list[NDArray[np.float32]]:
    """Vertices of every `o` group of an OBJ file."""
    groups: list[list[list[float]]] = []
    for line in path.read_text().splitlines():
        if line.startswith("o "):
            groups.append([])
        elif line.startswith("v "):
            if not groups:
                groups.append([])
            groups[-1].append([float(word) for word in line.split()[1:4]])
    return [np.array(group, dtype=np.float32) for group in groups if group]
