"""Objects of the simulated world, and their catalogue files.

An object has convex parts for contact, a mesh for the camera, mass and friction.

A catalogue is one `.npz` file (no pickles) or a folder with `manifest.json` (import format, one visual and one convex
collision mesh per object). Frame of an object: origin at its centre of mass, metres.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from dgs_description.arrays import load_arrays, save_arrays
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.paths import models_dir
from dgs_sim_bridge.render.raster import Mesh

SHAPE_CLASSES = ("cuboid", "cylinder", "stick", "sphere", "bowl")
CATALOGUES = {"novel": "novel_objects.npz", "household": "household_objects.npz", "train": "dataset.npz"}
"""Files of the named catalogues in the models folder; the dataset holds the objects that it is about."""
OPAQUE, GLASS, MIRROR = MATERIALS = ("opaque", "glass", "mirror")
"""What light does to an object; contact does not depend on it."""
LARGEST = 1.0
"""An object that reaches farther from its centre of mass is none for a table [m]."""


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
        material: one of `MATERIALS`.
    """

    name: str
    shape_class: str
    family: str
    mass: float
    parts: tuple[NDArray[np.float32], ...]
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    friction: float = 1.0
    material: str = OPAQUE

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
    def mesh(self) -> Mesh:
        """The visual mesh."""
        return self.vertices, self.faces

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
    save_arrays(path, catalogue_to_arrays(objects))


def catalogue_to_arrays(objects: Sequence[ObjectModel]) -> dict[str, NDArray]:
    """The arrays that `save_catalogue` writes; `material` is left out where all are opaque."""
    materials = [o.material for o in objects]
    seen_through = {} if set(materials) <= {OPAQUE} else {"material": np.array(materials)}
    faces = np.concatenate([o.faces for o in objects])
    return {
        **seen_through,
        "name": np.array([o.name for o in objects]),
        "shape_class": np.array([o.shape_class for o in objects]),
        "family": np.array([o.family for o in objects]),
        "mass": np.array([o.mass for o in objects], dtype=np.float32),
        "friction": np.array([o.friction for o in objects], dtype=np.float32),
        "vertices": np.concatenate([o.vertices for o in objects]).astype(np.float32),
        "faces": faces.astype(np.uint16 if faces.max() < 2**16 else np.int32),
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
    try:
        path = Path(name).expanduser()
    except RuntimeError as error:  # a home folder of nobody
        raise DgsError(ErrorCode.SIM_CATALOGUE, f"no object catalogue at {name}: {error}") from error
    return load_catalogue(path)


def load_catalogue(path: Path) -> list[ObjectModel]:
    """Read a catalogue: a `.npz` written by `save_catalogue`, or a folder with `manifest.json`.

    Raises:
        DgsError: SIM_CATALOGUE: nothing is there, it is neither of the two, or its objects cannot be.
    """
    try:
        if not (path.is_dir() or path.is_file()):
            raise DgsError(ErrorCode.SIM_CATALOGUE, f"no object catalogue at {path}")
        models = _load_manifest(path) if path.is_dir() else catalogue_from_arrays(load_arrays(path))
        names: set[str] = set()
        for model in models:
            if checked(model).name in names:
                raise _impossible(model, "another one has its name")
            names.add(model.name)
        return models
    except DgsError:
        raise
    except (
        Exception
    ) as error:  # a foreign file fails in as many ways as the readers of zip, JSON and meshes have
        wrong = f"{path} is no object catalogue ({type(error).__name__}: {error})"
        cure = "name a file of `dgs objects` or a folder of `dgs import`"
        raise DgsError(ErrorCode.SIM_CATALOGUE, f"{wrong}; {cure}") from error


def checked(model: ObjectModel) -> ObjectModel:
    """The model. Raises DgsError SIM_CATALOGUE if it is no body that can be simulated and seen."""
    if not (isinstance(model.name, str) and isinstance(model.family, str)):
        raise _impossible(model, f"its name and its family {model.family!r} must be text")
    corners, faces = model.vertices, model.faces
    if not (corners.ndim == 2 and corners.shape[1] == 3 and faces.ndim == 2 and faces.shape[1] == 3):
        raise _impossible(
            model, f"its mesh has shapes {corners.shape} and {faces.shape}, (V, 3) and (F, 3) are wanted"
        )
    if not len(corners) or not len(faces) or not 0 <= faces.min() <= faces.max() < len(corners):
        raise _impossible(model, f"its mesh of {len(corners)} corners is empty or has faces with others")
    if not (
        np.isfinite(model.mass) and np.isfinite(model.friction) and model.mass > 0 and model.friction >= 0
    ):
        raise _impossible(model, f"mass {model.mass} kg and friction {model.friction} cannot be")
    if model.shape_class not in SHAPE_CLASSES:
        wrong = f"its shape class is {model.shape_class!r}, none of {', '.join(SHAPE_CLASSES)}"
        raise _impossible(model, wrong)
    if model.material not in MATERIALS:
        raise _impossible(model, f"its material is {model.material!r}, none of {', '.join(MATERIALS)}")
    if not model.parts:
        raise _impossible(model, "it has no convex parts")
    for points in (corners, *model.parts):
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise _impossible(model, "a part has points that are not finite or not (V, 3)")
        if np.abs(points).max() > LARGEST or np.linalg.matrix_rank(points - points[0], tol=1e-6) < 3:
            raise _impossible(model, f"a part is flat, or reaches beyond {LARGEST} m; lengths are in metres")
    return model


def _impossible(model: ObjectModel, why: str) -> DgsError:
    return DgsError(ErrorCode.SIM_CATALOGUE, f"object {model.name!r}: {why}")


def catalogue_from_arrays(data: Mapping[str, NDArray]) -> list[ObjectModel]:
    """Objects from the arrays that `save_catalogue` writes, the dataset file too. Raises KeyError, ValueError."""
    vertices = pieces(data["vertices"], data["vertex_count"])
    faces = pieces(data["faces"].astype(np.int32), data["face_count"])
    parts = pieces(data["part_vertices"], data["part_vertex_count"])
    first = np.concatenate([[0], np.cumsum(data["part_count"])])
    if first[-1] != len(parts):
        raise ValueError(f"{len(parts)} parts belong to objects with {first[-1]}")
    columns = [data[key].tolist() for key in ("name", "shape_class", "family", "mass")]
    own = (tuple(parts[a:b]) for a, b in pairwise(first))
    friction = data["friction"].tolist()
    materials = data["material"].tolist() if "material" in data else [OPAQUE] * len(friction)
    rows = zip(*columns, own, vertices, faces, friction, materials, strict=True)
    return [ObjectModel(*row) for row in rows]


def pieces(stacked: NDArray, counts: NDArray) -> list[NDArray]:
    """The rows of an array cut into pieces of so many rows each. Raises ValueError where they are not as many."""
    if (
        counts.ndim != 1
        or counts.dtype.kind not in "iu"
        or (counts < 0).any()
        or counts.sum() != len(stacked)
    ):
        raise ValueError(f"{len(stacked)} rows cannot be divided by the counts that come with them")
    return np.split(stacked, np.cumsum(counts))[: len(counts)]


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
                material=record.get("material", OPAQUE),
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
