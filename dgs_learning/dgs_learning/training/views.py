"""Single-view training clouds, rendered on the fly from scene poses with the camera's noise (section V-B)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dgs_description.camera import PinholeCamera
from dgs_description.errors import DgsError
from dgs_description.files import atomic_write
from dgs_description.frames import Array, apply, inverse, look_at
from dgs_grasp_planner.preprocess import LOWEST, prepare_rows
from dgs_learning.dataset import GraspDataset
from dgs_learning.made_from import mark_folder
from dgs_perception.edges import cleaned
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.render.raster import TABLE, Mesh, box_mesh
from dgs_sim_bridge.render.shot import Shot, Stage, take_shot

Sense = Callable[[Stage, PinholeCamera, Array, D455Noise, np.random.Generator], Shot]
"""Stage, camera, T_world_camera, noise, generator -> what is seen: `take_shot`, or one that improves its depth."""

LEFT, MARGIN = 70, 24
"""So much around the things is rendered where no more of the table is wanted: to the left, where the right imager sees
nothing, and to the other sides [px]."""
WHOLE = 4
"""Every so many views are of the whole image: that the bare table's noise may look like something is learnt there."""
TABLE_MESH = box_mesh((-0.6, -0.6, -0.02), (0.6, 0.6, 0.0))


def table_mesh(edge: float | None) -> Mesh:
    """The table top, or what of it lies at x >= `edge` [m]."""
    return TABLE_MESH if edge is None else box_mesh((edge, -0.6, -0.02), (0.6, 0.6, 0.0))


@dataclass(frozen=True)
class ViewSettings:
    """Where the camera stands and what it does wrong.

    A little beyond the paper's 1 m hemisphere at 22.5 to 67.5 degrees, so that a real mount need not be exact.
    """

    distance: tuple[float, float] = (0.85, 1.15)
    elevation: tuple[float, float] = (float(np.deg2rad(22.5)), float(np.deg2rad(75.0)))
    noise: D455Noise = D455Noise()
    crop: tuple[float, float, float] = (0.42, 0.42, 0.30)
    """Half extent in x and y and the height of the kept volume [m]."""
    sense: Sense = take_shot
    edges: bool = True
    """Flying pixels are set right, as in the camera node."""

    def described(self) -> dict[str, Any]:
        """All but `sense`, JSON-ready."""
        return {key: value for key, value in asdict(self).items() if key != "sense"}


@dataclass(frozen=True)
class View:
    """One cloud in the frame *table*.

    Attributes:
        points: (N, 3) float32 [m].
        instance: (N,) int16 object of the scene that each point belongs to, -1 = table.
        camera: (3,) position of the camera [m].
    """

    points: NDArray[np.float32]
    instance: NDArray[np.int16]
    camera: Array


def camera_pose(rng: np.random.Generator, settings: ViewSettings) -> Array:
    """(4, 4) T_table_camera: a random place on the hemisphere, looking near the centre."""
    distance, elevation = rng.uniform(*settings.distance), rng.uniform(*settings.elevation)
    azimuth = rng.uniform(-np.pi, np.pi)
    target = np.array([*rng.uniform(-0.05, 0.05, 2), 0.0])
    level = np.cos(elevation)
    direction = np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])
    return look_at(target + distance * direction, target)


def capture(
    models: Sequence[ObjectModel],
    T_table_object: Sequence[Array] | Array,
    rng: np.random.Generator,
    settings: ViewSettings,
    edge: float | None = None,
    whole: bool = True,
) -> View:
    """The noisy cloud of objects on the table from a random viewpoint, cropped to the workspace.

    Args:
        edge: the table is where x is larger than this [m]; None = everywhere.
        whole: of the whole image, else of what shows the objects and the table beside them, in a third of the time.
    """
    meshes, materials = [model.mesh for model in models], [model.material for model in models]
    stage = Stage(meshes, T_table_object, materials, table_mesh(edge))
    return capture_stage(stage, rng, settings, None if whole else _corners(models, T_table_object))


def _corners(models: Sequence[ObjectModel], T_table_object: Sequence[Array] | Array) -> Array:
    """(N, 3) the objects' vertices, and what is beneath them on the table [m]."""
    poses = zip(models, T_table_object, strict=True)
    corners = np.concatenate([apply(pose, model.vertices.astype(float)) for model, pose in poses])
    return np.concatenate([corners, corners * (1.0, 1.0, 0.0)])


def window(camera: PinholeCamera, points: Array) -> PinholeCamera:
    """The part of an image that shows `points` (N, 3) in the camera's frame [m], and its principal point."""
    pixels = np.concatenate([camera.project(points), [(camera.cx, camera.cy)]])
    size = np.array([camera.width, camera.height])
    low = np.clip(np.floor(pixels.min(axis=0)) - (LEFT, MARGIN), 0, size).astype(int).tolist()
    high = np.clip(np.ceil(pixels.max(axis=0)) + MARGIN, 0, size).astype(int).tolist()
    (left, top), (right, bottom) = low, high
    return replace(camera, width=right - left, height=bottom - top, cx=camera.cx - left, cy=camera.cy - top)


def capture_stage(
    stage: Stage, rng: np.random.Generator, settings: ViewSettings, around: Array | None = None
) -> View:
    """The same of any meshes in the frame *table*, the table's among them; of what shows `around` (N, 3), if given."""
    T_table_camera = camera_pose(rng, settings)
    camera = D455 if around is None else window(D455, apply(inverse(T_table_camera), around))
    shot = settings.sense(stage, camera, T_table_camera, settings.noise, rng)
    depth = shot.depth
    if settings.edges:
        depth = cleaned(depth, camera)
    # In single precision (0.1 um at this distance): all pixels of the image go through here.
    rotation, position = T_table_camera[:3, :3].astype(np.float32), T_table_camera[:3, 3].astype(np.float32)
    points = camera.deproject(depth) @ rotation.T + position
    ids = shot.truth.ids.reshape(-1)[depth.reshape(-1) > 0]
    half_x, half_y, top = settings.crop
    x, y, z = points.T
    inside = (np.abs(x) < half_x) & (np.abs(y) < half_y) & (z > -0.02) & (z < top)
    ids = np.where(ids == TABLE, -1, ids)
    return View(points[inside], ids[inside].astype(np.int16), T_table_camera[:3, 3])


class ViewSource:
    """Views of a dataset by number: view v of scene s is always the same, so it may be kept on disk."""

    def __init__(
        self,
        dataset: GraspDataset,
        seed: int,
        keep_table: bool = False,
        cache: Path | None = None,
    ):
        """`cache`: folder that keeps the views. DgsError, REQUEST_INVALID, if it holds views of another source."""
        self.dataset, self.seed, self.cache = dataset, seed, cache
        self.settings, self.keep_table = ViewSettings(), keep_table
        if cache is not None:
            own = {"dataset": dataset.seen_digest(), "seed": seed, "keep_table": keep_table}
            own |= {} if keep_table else {"window": [LEFT, MARGIN, WHOLE]}
            mark_folder(cache, own | self.settings.described())

    def view(self, scene: int, number: int) -> View:
        """The prepared cloud: table points far from any object dropped, at most 20 000 points.

        Where nothing stands out of the noise, that of the whole table.
        """
        path = None if self.cache is None else self.cache / f"scene{scene:04d}_view{number:04d}.npz"
        if path is not None and path.exists():
            with np.load(path, allow_pickle=False) as data:
                return View(data["points"].astype(np.float32), data["instance"], data["camera"])
        rng, whole = np.random.default_rng([self.seed, scene, number]), self.keep_table or number % WHOLE == 0
        stored = self.dataset.scenes[scene]
        models = [self.dataset.objects[k] for k in stored.objects]
        view = capture(models, stored.T_table_object, rng, self.settings, whole=whole)
        try:
            rows = prepare_rows(view.points, rng, keep_table=self.keep_table)
        except DgsError:
            rows = prepare_rows(view.points, rng, object_height=LOWEST)
        # Half precision (0.25 mm at 0.4 m) also where nothing is kept, so that a cached view equals a fresh one.
        kept = view.points[rows].astype(np.float16)
        view = View(kept.astype(np.float32), view.instance[rows], view.camera)
        if path is not None:
            with atomic_write(path) as file:
                np.savez(file, points=kept, instance=view.instance, camera=view.camera)
        return view
