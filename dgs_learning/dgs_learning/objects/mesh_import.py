"""Turns mesh files into the import format: a folder with `manifest.json` that every program of the suite reads."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write
from dgs_description.native import preload_libusb
from dgs_learning.objects.catalogue import MASS_RANGE
from dgs_learning.objects.decomposition import convex_parts, volume_and_centre
from dgs_sim_bridge.render.object_model import SHAPE_CLASSES

SUFFIXES = (".obj", ".stl", ".ply", ".glb", ".gltf")
MAX_FACES = 2000
SMALLEST, LARGEST = 0.005, 0.5
"""Extents outside of which the unit is doubted [m]."""
Y_UP = (".glb", ".gltf")
HOLLOW = 0.5
"""Share of the convex hull below which something is a vessel, if it is not long."""
LONG = 2.2
"""Ratio of the two largest extents above which something is long."""
THIN = 0.037
"""A long thing whose smallest extent is below this is a stick [m]."""
ROUND_FILL = 0.66
"""A ball fills pi/6 = 0.52 of its box, a cylinder pi/4 = 0.79."""
CYLINDER_FILL = 0.85
SQUARE = 1.25
"""Two extents with a ratio below this count as equal."""
COMPACT = 1.8
"""Ratio of largest to smallest extent below which something can be a sphere."""

_refused = partial(DgsError, ErrorCode.SIM_CATALOGUE)


@dataclass(frozen=True)
class ImportSettings:
    """What is done to the meshes.

    Attributes:
        scale: factor from the file's unit to metres (0.001 for millimetres).
        up: axis that points up in the file, "y" or "z"; "" = y for GLB and glTF, as their standard says, else z.
        density: for the mass [kg/m^3]; most household things have 200 to 1000, because they are not solid.
        mass: of every object instead [kg].
        shape_class: of every object; "" = guessed.
        threshold, max_hulls: how finely concave meshes are cut, see `convex_parts`.
    """

    scale: float = 1.0
    up: str = ""
    density: float = 400.0
    mass: float | None = None
    shape_class: str = ""
    threshold: float = 0.05
    max_hulls: int = 16

    def __post_init__(self) -> None:
        if self.shape_class and self.shape_class not in SHAPE_CLASSES:
            raise _refused(f"no shape class {self.shape_class!r}; there are {', '.join(SHAPE_CLASSES)}")
        if self.up not in ("", "y", "z"):
            raise _refused(f"up is {self.up!r}, it can be y or z")
        for name, value in (("scale", self.scale), ("density", self.density), ("mass", self.mass)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise _refused(f"the {name} is {value}, it must be above 0")
        if not 0.01 <= self.threshold <= 1.0:
            raise _refused(f"the threshold is {self.threshold}, it must be from 0.01 to 1")


def find_meshes(given: Iterable[Path]) -> list[Path]:
    """Mesh files among files and folders, each once; folders are searched to their depth, except what was imported.

    Raises:
        DgsError: a path is missing or no mesh, or a folder holds none.
    """
    found: list[Path] = []
    for path in given:
        if not path.exists():
            raise _refused(f"{path} does not exist")
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        imported = {f.parent / "objects" for f in files if f.name == "manifest.json"}
        meshes = [f for f in files if f.suffix.lower() in SUFFIXES and imported.isdisjoint(f.parents)]
        if not meshes:
            kind = "holds no" if path.is_dir() else "is not one of"
            raise _refused(f"{path} {kind} {', '.join(SUFFIXES)}")
        found += meshes
    return list(dict.fromkeys(found))


def names_of(paths: list[Path]) -> list[str]:
    """A name per mesh: the file's stem, with its folder's name in front where stems repeat.

    Raises:
        DgsError: two meshes would have the same name.
    """
    stems = [path.stem for path in paths]
    names = [p.stem if stems.count(p.stem) == 1 else f"{p.resolve().parent.name}_{p.stem}" for p in paths]
    names = [re.sub(r"[^A-Za-z0-9_.-]+", "_", name) for name in names]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise _refused(f"several meshes would be named {', '.join(doubled)}: rename the files")
    return names


def read_mesh(path: Path, settings: ImportSettings) -> trimesh.Trimesh:
    """The mesh in metres with z up, all its pieces in one.

    Raises:
        DgsError: it cannot be read, has no volume, or its size is unlikely.
    """
    try:
        mesh = trimesh.load(path, force="mesh")
        assert isinstance(mesh, trimesh.Trimesh)
    except Exception as error:
        raise _refused(f"{path} cannot be read as a mesh: {error}") from error
    if len(mesh.faces) < 4 or not np.isfinite(mesh.vertices).all():
        raise _refused(f"{path} has {len(mesh.faces)} faces or vertices that are not finite")
    mesh = trimesh.Trimesh(mesh.vertices * settings.scale, mesh.faces)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    if not mesh.is_watertight:  # in a closed mesh a sliver closes a gap
        mesh.update_faces(mesh.nondegenerate_faces())
        mesh.remove_unreferenced_vertices()
    flat = _refused(f"{path} is flat, it has no volume")
    if not len(mesh.faces):  # slivers all of them
        raise flat
    if (settings.up or ("y" if path.suffix.lower() in Y_UP else "z")) == "y":
        mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    largest = float(np.max(mesh.extents))
    if not SMALLEST <= largest <= LARGEST:
        cure = "give the scale from its unit to metres (0.001 for millimetres)"
        raise _refused(f"{path} would be {largest:.4g} m long: {cure}")
    corners = mesh.triangles.reshape(-1, 3)
    axes = np.linalg.svd(corners - corners.mean(axis=0), full_matrices=False)[2]
    if np.ptp(corners @ axes.T, axis=0).min() < 1e-4:
        raise flat
    if mesh.is_watertight and mesh.volume < 0:
        mesh.invert()
    return mesh


def simplified(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh with at most `MAX_FACES` triangles (quadric decimation)."""
    if len(mesh.faces) <= MAX_FACES:
        return mesh
    preload_libusb()
    import open3d as o3d  # a large library: only large meshes need it

    corners, triangles = o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.faces)
    small = o3d.geometry.TriangleMesh(corners, triangles).simplify_quadric_decimation(MAX_FACES)
    return trimesh.Trimesh(np.asarray(small.vertices), np.asarray(small.triangles), process=False)


def guess_shape_class(extents: ArrayLike, volume: float, hull_volume: float) -> str:
    """One of `SHAPE_CLASSES`: a rule of thumb, to be overruled by the person who knows the object.

    Args:
        extents: three edges of the oriented box [m].
        volume, hull_volume: of the mesh and of its convex hull [m^3].
    """
    a, b, c = np.sort(extents)
    fill = hull_volume / (a * b * c)
    if c / b > LONG and a < THIN:
        return "stick"
    if volume / hull_volume < HOLLOW:
        return "bowl"
    if c / a < COMPACT and fill < ROUND_FILL:
        return "sphere"
    if fill < CYLINDER_FILL and (b / a < SQUARE or c / b < SQUARE):
        return "cylinder"
    return "cuboid"


def import_mesh(path: Path, name: str, folder: Path, settings: ImportSettings) -> dict[str, Any]:
    """Write `objects/NAME/visual.obj` and `collision.obj` and return the object's record for the manifest."""
    mesh = read_mesh(path, settings)
    parts = convex_parts(mesh, settings.threshold, settings.max_hulls)
    volume, centre = volume_and_centre(parts)
    if mesh.is_volume:
        volume, centre = float(mesh.volume), mesh.center_mass
    mesh.apply_translation(-centre)
    parts = [part - centre for part in parts]
    visual = simplified(mesh)
    extents = trimesh.bounds.oriented_bounds(mesh.convex_hull)[1]
    hull_volume = float(mesh.convex_hull.volume)
    shape_class = settings.shape_class or guess_shape_class(extents, min(volume, hull_volume), hull_volume)
    guessed = float(np.clip(settings.density * volume, *MASS_RANGE))
    mass = guessed if settings.mass is None else settings.mass
    target = folder / "objects" / name
    target.mkdir(parents=True, exist_ok=True)
    files = {"visual": target / "visual.obj", "collision": target / "collision.obj"}
    hulls = {f"hull_{k:02d}": trimesh.convex.convex_hull(part) for k, part in enumerate(parts)}
    for kind, shape in (("visual", visual), ("collision", trimesh.Scene(hulls))):  # one `o` group per mesh
        text = trimesh.exchange.obj.export_obj(shape, include_normals=False, header=None, digits=6)
        files[kind].write_text(f"{text}\n")
    return {
        "name": name,
        "shape_class": shape_class,
        "shape_class_guessed": not settings.shape_class,
        "family": name,
        "source": path.name,
        "source_sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "scale_applied": settings.scale,
        "mass_kg": float(f"{mass:.4g}"),
        "mass_basis": "given" if settings.mass is not None else f"volume x {settings.density:g} kg/m3",
        "watertight_source": bool(mesh.is_volume),
        "extents_obb_m": [round(float(e), 5) for e in np.sort(extents)],
        "source_faces": len(mesh.faces),
        "visual_faces": len(visual.faces),
        "n_hulls": len(parts),
        "files": {kind: file.relative_to(folder).as_posix() for kind, file in files.items()},
        "sha256": {kind: hashlib.sha256(file.read_bytes()).hexdigest() for kind, file in files.items()},
    }


def write_manifest(folder: Path, record: dict[str, Any]) -> None:
    """Write an object's record into `manifest.json`; the other objects that the folder has stay.

    Raises:
        DgsError: there is a manifest of something else.
    """
    path = folder / "manifest.json"
    try:
        there = json.loads(path.read_text())["objects"] if path.is_file() else []
        named = {old["name"]: old for old in there}
    except (ValueError, KeyError, TypeError) as error:
        raise _refused(f"{path} lists no objects ({error}): name another folder") from error
    objects = [one for _, one in sorted((named | {record["name"]: record}).items())]
    manifest = {
        "units": "metres, kilograms, seconds",
        "frame": "origin at the centre of mass, z up",
        "objects": objects,
    }
    with atomic_write(path, "w") as file:
        file.write(json.dumps(manifest, indent=1) + "\n")
