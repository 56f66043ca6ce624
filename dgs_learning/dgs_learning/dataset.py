"""The compact dataset file.

Small meshes, quantised grasps, scene poses and which grasp is feasible where. One `.npz`, no pickles.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from dgs_description.joints import FINGER_LOWER, FINGER_UPPER, expand_active, reduce_to_active
from dgs_learning.objects.symmetry import symmetries
from dgs_sim_bridge.render.object_model import ObjectModel, catalogue_from_arrays, catalogue_to_arrays

Array = NDArray[np.float64]

VERSION = 1
POSITION_STEP = 1e-5
"""Quantisation of positions [m]."""
_LOWER, _UPPER = np.tile(FINGER_LOWER[:3], 5), np.tile(FINGER_UPPER[:3], 5)


@dataclass(frozen=True)
class SceneGrasps:
    """One scene in the frame *table* with its feasible grasps.

    Attributes:
        objects: (N,) index into `GraspDataset.objects`.
        T_table_object: (N, 4, 4) poses.
        instance: (G,) which of the N objects a grasp belongs to.
        grasp: (G,) index into the grasps of that object.
        symmetry: (G,) index into `symmetries(family)` by which the stored grasp is turned.
    """

    objects: NDArray[np.int64]
    T_table_object: Array
    instance: NDArray[np.int64]
    grasp: NDArray[np.int64]
    symmetry: NDArray[np.int64]


@dataclass(frozen=True)
class TableGrasps:
    """Grasps in the frame *table*.

    Position (G, 3), rotation (G, 3, 3), joints (G, 20), active (G, 5), instance (G,).
    """

    position: Array
    rotation: Array
    joints: Array
    active: NDArray[np.bool_]
    instance: NDArray[np.int64]


@dataclass(frozen=True)
class GraspDataset:
    """Everything that training needs.

    Attributes:
        objects: the objects at the scales they are used in.
        first: (O + 1,) grasps first[k]..first[k + 1] belong to object k.
        position: (G, 3) [m], rotation: (G, 3, 3), joints: (G, 20) [rad], fingers: (G,).
            Stage-1 grasps in the object's frame.
        uniform: (G,) drawn as the paper draws.
        scenes: stage 2.
        drawn, trials: (O,) candidates drawn and simulated per object; None in a file that does not say.
    """

    objects: list[ObjectModel]
    first: NDArray[np.int64]
    position: Array
    rotation: Array
    joints: Array
    fingers: NDArray[np.int64]
    uniform: NDArray[np.bool_]
    scenes: list[SceneGrasps]
    drawn: NDArray[np.int64] | None = None
    trials: NDArray[np.int64] | None = None

    @property
    def active(self) -> NDArray[np.bool_]:
        """(G, 5) fingers that take part."""
        return active_of(self.fingers)

    def without(self, numbers: Collection[int]) -> GraspDataset:
        """The dataset without the stage-1 grasps of these rows, in the scenes too."""
        keep = np.ones(len(self.position), dtype=bool)
        keep[list(numbers)] = False
        before = np.concatenate([[0], np.cumsum(keep)])
        scenes = []
        for scene in self.scenes:
            owner = scene.objects[scene.instance]
            row = self.first[owner] + scene.grasp
            stays = keep[row]
            scenes.append(
                replace(
                    scene,
                    instance=scene.instance[stays],
                    grasp=(before[row] - before[self.first[owner]])[stays],
                    symmetry=scene.symmetry[stays],
                )
            )
        return replace(
            self,
            first=before[self.first],
            position=self.position[keep],
            rotation=self.rotation[keep],
            joints=self.joints[keep],
            fingers=self.fingers[keep],
            uniform=self.uniform[keep],
            scenes=scenes,
        )

    def scene_grasps(self, scene: SceneGrasps) -> TableGrasps:
        """A scene's feasible grasps in the frame *table*."""
        index = self.first[scene.objects[scene.instance]] + scene.grasp
        turn = np.empty((len(index), 3, 3))
        for instance in np.unique(scene.instance):
            mine = scene.instance == instance
            turn[mine] = symmetries(self.objects[scene.objects[instance]].family)[scene.symmetry[mine]]
        T = scene.T_table_object[scene.instance]
        rotation = T[:, :3, :3] @ turn
        return TableGrasps(
            position=np.einsum("nij,nj->ni", rotation, self.position[index]) + T[:, :3, 3],
            rotation=rotation @ self.rotation[index],
            joints=self.joints[index],
            active=self.active[index],
            instance=scene.instance,
        )


def active_of(fingers: NDArray) -> NDArray[np.bool_]:
    """(G, 5) active fingers of 5-, 3- and 2-finger grasps (G,)."""
    n = np.asarray(fingers)[:, None]
    return np.concatenate([n >= 2, n >= 2, n >= 3, n >= 5, n >= 5], axis=1)


def _quaternions_to_int(rotation: Array) -> NDArray[np.int16]:
    if not len(rotation):
        return np.zeros((0, 4), np.int16)
    return np.round(Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_quat() * 32767).astype(np.int16)


def _quaternions_from_int(values: NDArray[np.int16]) -> Array:
    return Rotation.from_quat(values.astype(np.float64)).as_matrix() if len(values) else np.empty((0, 3, 3))


def save_dataset(path: Path, data: GraspDataset) -> None:
    """Write the file; joints take one byte each (steps of 2 to 6 mrad), rotations 2 bytes a component."""
    share = (reduce_to_active(data.joints) - _LOWER) / (_UPPER - _LOWER)
    arrays = catalogue_to_arrays(data.objects)
    scenes = data.scenes
    arrays |= {
        "version": np.array(VERSION),
        "first": data.first.astype(np.int32),
        "grasp_position": np.round(data.position / POSITION_STEP).astype(np.int16),
        "grasp_rotation": _quaternions_to_int(data.rotation),
        "grasp_joints": np.round(np.clip(share, 0, 1) * 255).astype(np.uint8),
        "grasp_fingers": data.fingers.astype(np.uint8),
        "grasp_uniform": data.uniform,
        "scene_objects": _stack([s.objects for s in scenes], np.int16),
        "scene_object_count": np.array([len(s.objects) for s in scenes], dtype=np.int32),
        "scene_position": _stack([s.T_table_object[:, :3, 3] for s in scenes], np.float32, (3,)),
        "scene_rotation": _quaternions_to_int(
            _stack([s.T_table_object[:, :3, :3] for s in scenes], np.float64, (3, 3))
        ),
        "scene_instance": _stack([s.instance for s in scenes], np.uint8),
        "scene_grasp": _stack([s.grasp for s in scenes], np.uint16),
        "scene_symmetry": _stack([s.symmetry for s in scenes], np.uint8),
        "scene_grasp_count": np.array([len(s.instance) for s in scenes], dtype=np.int32),
    }
    if data.drawn is not None and data.trials is not None:
        arrays |= {"drawn": data.drawn.astype(np.int32), "trials": data.trials.astype(np.int32)}
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, allow_pickle=False, **arrays)


def _stack(parts: Sequence[NDArray], dtype: type, shape: tuple[int, ...] = ()) -> NDArray:
    return np.concatenate([np.zeros((0, *shape)), *parts]).astype(dtype)


def load_dataset(path: Path) -> GraspDataset:
    """Read what `save_dataset` wrote.

    Raises:
        FileNotFoundError: nothing there.
        ValueError: another version.
    """
    with np.load(path, allow_pickle=False) as z:
        data = {name: z[name] for name in z.files}
    if int(data["version"]) != VERSION:
        raise ValueError(f"{path} has version {int(data['version'])}, this program reads {VERSION}")
    objects_end, grasps_end = np.cumsum(data["scene_object_count"]), np.cumsum(data["scene_grasp_count"])
    poses = np.tile(np.eye(4), (int(objects_end[-1]) if len(objects_end) else 0, 1, 1))
    poses[:, :3, :3] = _quaternions_from_int(data["scene_rotation"])
    poses[:, :3, 3] = data["scene_position"]
    scenes = []
    for o1, on, g1, gn in zip(
        objects_end, data["scene_object_count"], grasps_end, data["scene_grasp_count"], strict=True
    ):
        own, feasible = slice(o1 - on, o1), slice(g1 - gn, g1)
        scenes.append(
            SceneGrasps(
                objects=data["scene_objects"][own].astype(np.int64),
                T_table_object=poses[own],
                instance=data["scene_instance"][feasible].astype(np.int64),
                grasp=data["scene_grasp"][feasible].astype(np.int64),
                symmetry=data["scene_symmetry"][feasible].astype(np.int64),
            )
        )
    joints = expand_active(data["grasp_joints"] / 255.0 * (_UPPER - _LOWER) + _LOWER)
    return GraspDataset(
        objects=catalogue_from_arrays(data),
        first=data["first"].astype(np.int64),
        position=data["grasp_position"] * POSITION_STEP,
        rotation=_quaternions_from_int(data["grasp_rotation"]),
        joints=joints,
        fingers=data["grasp_fingers"].astype(np.int64),
        uniform=data["grasp_uniform"],
        scenes=scenes,
        drawn=data["drawn"].astype(np.int64) if "drawn" in data else None,
        trials=data["trials"].astype(np.int64) if "trials" in data else None,
    )
