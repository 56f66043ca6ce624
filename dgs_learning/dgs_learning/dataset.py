"""The compact dataset file, one `.npz`: small meshes, quantised grasps, scenes and which grasp is feasible where."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from dgs_description.arrays import load_arrays, save_arrays
from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_description.grasp import GraspSet
from dgs_description.hand import DEFAULT, HAND, check_hand
from dgs_learning.objects.symmetry import symmetries
from dgs_sim_bridge.render.object_model import ObjectModel, catalogue_from_arrays, catalogue_to_arrays, pieces

VERSION = 2
GUIDED, UNIFORM, LEVEL, VARIED = SOURCES = ("guided", "uniform", "level", "varied")
"""How a stage-1 grasp was drawn: around a cross-section that fits the hand, as the paper does, as a level pinch of what
lies low, which has a pre-grasp of its own, or near another that holds (near a level pinch it counts as one)."""
POSITION_STEP = 1e-5
"""Quantisation of positions [m]."""
FARTHEST = 32767 * POSITION_STEP
"""Of a TCP from its object's origin along each axis [m]: what lies beyond would come out on the other side."""
GAP_STEP, TOUCHING = 1e-4, 0.003
"""Quantisation of gaps, and up to which one a finger counts as touching [m]."""
_UNKNOWN = 255
_LOWER, _UPPER = HAND.reduce(HAND.lower), HAND.reduce(HAND.upper)


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
class GraspDataset:
    """Everything that training needs.

    Attributes:
        objects: the objects at the scales they are used in.
        first: (O + 1,) grasps first[k]..first[k + 1] belong to object k.
        grasps: of stage 1, each in its object's frame; `source` is one of `SOURCES`.
        friction: (G,) lowest at which a grasp holds in the second engine; NaN = not tried.
        gap: (G, F) distance of each closed finger to the object, at most 25 mm [m]; NaN = not measured.
        scenes: stage 2.
        drawn, trials: (O,) candidates drawn and simulated per object.
    """

    objects: list[ObjectModel]
    first: NDArray[np.int64]
    grasps: GraspSet
    friction: Array
    gap: Array
    scenes: list[SceneGrasps]
    drawn: NDArray[np.int64]
    trials: NDArray[np.int64]

    @property
    def fingers(self) -> NDArray[np.int64]:
        """(G,) number of fingers that take part: 2 to 5."""
        return self.grasps.active_fingers.sum(axis=1)

    @cached_property
    def in_air(self) -> NDArray[np.bool_]:
        """(G, F) fingers that take part and meet nothing: where they have closed to says nothing of the object."""
        return self.grasps.active_fingers & (self.gap > TOUCHING)

    @property
    def owner(self) -> NDArray[np.int64]:
        """(G,) object that each grasp belongs to."""
        return np.repeat(np.arange(len(self.objects)), np.diff(self.first))

    def own(self, number: int) -> GraspSet:
        """The stage-1 grasps of an object."""
        return self.grasps[self.first[number] : self.first[number + 1]]

    def rows(self, scene: SceneGrasps) -> NDArray[np.int64]:
        """(S,) stage-1 grasps that a scene's feasible grasps come from."""
        return self.first[scene.objects[scene.instance]] + scene.grasp

    def seen_digest(self) -> str:
        """Hash of all that can be seen: the objects, and where they stand in the scenes."""
        digest = hashlib.sha256()
        for array in catalogue_to_arrays(self.objects).values():
            digest.update(array.tobytes())
        for scene in self.scenes:
            digest.update(scene.objects.tobytes() + scene.T_table_object.astype(np.float32).tobytes())
        return digest.hexdigest()[:16]

    def without(self, numbers: Collection[int]) -> GraspDataset:
        """The dataset without the stage-1 grasps of these rows, in the scenes too."""
        keep = np.ones(len(self.grasps), dtype=bool)
        keep[list(numbers)] = False
        before = np.concatenate([[0], np.cumsum(keep)])
        scenes = []
        for scene in self.scenes:
            row = self.rows(scene)
            stays, grasp = keep[row], before[row] - before[row - scene.grasp]
            instance, symmetry = scene.instance[stays], scene.symmetry[stays]
            scenes.append(replace(scene, instance=instance, grasp=grasp[stays], symmetry=symmetry))
        kept = replace(self, grasps=self.grasps[keep], friction=self.friction[keep], gap=self.gap[keep])
        return replace(kept, first=before[self.first], scenes=scenes)

    def thinned(self, most: int, seed: int) -> GraspDataset:
        """The dataset with at most `most` stage-1 grasps of each object, drawn at random."""
        order = np.random.default_rng([seed, 18]).permutation(len(self.grasps))
        order = order[np.argsort(self.owner[order], kind="stable")]
        rank = np.arange(len(order)) - self.first[self.owner[order]]
        return self.without(order[rank >= most].tolist())

    def scene_grasps(self, scene: SceneGrasps) -> GraspSet:
        """A scene's feasible grasps in the frame *table*, in the order of `scene.instance`; score = `steadiness`."""
        rows = self.rows(scene)
        grasps = self.grasps[rows]
        turn = np.empty((len(grasps), 3, 3))
        for instance in np.unique(scene.instance):
            mine = scene.instance == instance
            turn[mine] = symmetries(self.objects[scene.objects[instance]].family)[scene.symmetry[mine]]
        T_table_object = scene.T_table_object[scene.instance]
        rotation = T_table_object[:, :3, :3] @ turn
        position = np.einsum("nij,nj->ni", rotation, grasps.position) + T_table_object[:, :3, 3]
        turned = rotation @ grasps.rotation
        lever = np.linalg.norm((position - T_table_object[:, :3, 3])[:, :2], axis=1)
        return replace(
            grasps,
            position=position,
            rotation=turned,
            score=steadiness(self.friction[rows], lever),
            reference_point=position,
        )


LEVER = 0.04
"""How far beside the centre of mass a grasp loses most of its worth [m]."""
NEEDED = (0.3, 0.6)
"""Friction that a grasp needs at least to be worth all, and (almost) nothing."""


def steadiness(friction: ArrayLike, lever: ArrayLike) -> Array:
    """(G,) what grasps are worth as examples, in (0, 1]: with little friction, near the centre of mass.

    Args:
        friction: (G,) lowest one with which each holds; NaN = not tried, which counts as 0.5.
        lever: (G,) level distance of the TCP from the centre of mass [m].
    """
    lowest = np.where(np.asarray(friction) > 0, friction, 0.5)
    margin = np.clip((NEEDED[1] - lowest) / (NEEDED[1] - NEEDED[0]), 0.1, 1.0)
    return margin * np.maximum(np.exp(-np.square(np.asarray(lever) / LEVER)), 0.01)


def finger_pattern(fingers: ArrayLike) -> NDArray[np.bool_]:
    """(..., F) fingers that a grasp of so many (...) closes."""
    return np.asarray(HAND.grasp.patterns[np.minimum(fingers, HAND.finger_count) - 2])


def object_grasps(
    position: ArrayLike,
    rotation: ArrayLike,
    joints: Array,
    active: NDArray[np.bool_],
    source: NDArray[np.str_],
    before: ArrayLike | None = None,
) -> GraspSet:
    """G grasps of an object in its frame, with the pre-grasp of equation (9) where they have none of their own.

    Args:
        position: (G, 3) TCP [m], rotation: (G, 3, 3).
        joints: (G, J) final joints [rad].
        active: (G, F) fingers that take part.
        source: (G,) of `SOURCES`.
        before: (L, J) pre-grasp joints of those drawn as `LEVEL` [rad]; None where there are none.
    """
    open_hand = HAND.pre_grasp(joints, active).reshape(-1, HAND.joint_count)
    if before is not None:
        open_hand[source == LEVEL] = before
    grasps = GraspSet.of(
        GUIDED,
        position=position,
        rotation=rotation,
        pre_grasp_joints=open_hand,
        grasp_joints=joints,
        active_fingers=active,
    )
    return replace(grasps, source=source)


def _quaternions_to_int(rotation: Array) -> NDArray[np.int16]:
    return np.round(Rotation.from_matrix(rotation).as_quat() * 32767).astype(np.int16)


def _quaternions_from_int(values: NDArray[np.int16]) -> Array:
    return Rotation.from_quat(values.astype(np.float64)).as_matrix()


def _joints_to_int(joints: Array) -> NDArray[np.uint8]:
    share = (HAND.reduce(joints) - _LOWER) / (_UPPER - _LOWER)
    return np.round(np.clip(share, 0, 1) * 255).astype(np.uint8)


def _joints_from_int(values: NDArray[np.uint8]) -> Array:
    return HAND.expand(values / 255.0 * (_UPPER - _LOWER) + _LOWER)


def _positions_to_int(position: Array) -> NDArray[np.int16]:
    return np.round(position / POSITION_STEP).astype(np.int16)


def stored_alike(a: GraspSet, b: GraspSet) -> bool:
    """Whether the file holds the same positions and final joints for both, in the same order."""
    return np.array_equal(_positions_to_int(a.position), _positions_to_int(b.position)) and np.array_equal(
        _joints_to_int(a.grasp_joints), _joints_to_int(b.grasp_joints)
    )


def save_dataset(path: Path, data: GraspDataset) -> None:
    """Write the file; joints take one byte each (steps of 2 to 6 mrad), rotations 2 bytes a component."""
    scenes, source = data.scenes, data.grasps.source
    gap = np.clip(np.round(data.gap / GAP_STEP), 0, _UNKNOWN - 1)
    turns = _stack([s.T_table_object[:, :3, :3] for s in scenes], np.float64, (3, 3))
    arrays = catalogue_to_arrays(data.objects) | {
        "version": np.array(VERSION),
        "hand": np.array(HAND.name),
        "first": data.first.astype(np.int32),
        "drawn": data.drawn.astype(np.int32),
        "trials": data.trials.astype(np.int32),
        "grasp_position": _positions_to_int(data.grasps.position),
        "grasp_rotation": _quaternions_to_int(data.grasps.rotation),
        "grasp_joints": _joints_to_int(data.grasps.grasp_joints),
        "grasp_before": _joints_to_int(data.grasps.pre_grasp_joints[source == LEVEL]),
        "grasp_fingers": data.fingers.astype(np.uint8),
        "grasp_friction": np.nan_to_num(np.round(data.friction * 100)).astype(np.uint8),
        "grasp_gap": np.nan_to_num(gap, nan=_UNKNOWN).astype(np.uint8),
        "grasp_source": np.select([source == name for name in SOURCES], range(len(SOURCES))).astype(np.uint8),
        "scene_objects": _stack([s.objects for s in scenes], np.int16),
        "scene_object_count": np.array([len(s.objects) for s in scenes], dtype=np.int32),
        "scene_position": _stack([s.T_table_object[:, :3, 3] for s in scenes], np.float32, (3,)),
        "scene_rotation": _quaternions_to_int(turns),
        "scene_instance": _stack([s.instance for s in scenes], np.uint8),
        "scene_grasp": _stack([s.grasp for s in scenes], np.uint16),
        "scene_symmetry": _stack([s.symmetry for s in scenes], np.uint8),
        "scene_grasp_count": np.array([len(s.instance) for s in scenes], dtype=np.int32),
    }
    save_arrays(path, arrays)


def _stack(parts: Sequence[NDArray], dtype: type, shape: tuple[int, ...] = ()) -> NDArray:
    return np.concatenate([np.zeros((0, *shape)), *parts]).astype(dtype)


def load_dataset(path: Path) -> GraspDataset:
    """Read what `save_dataset` wrote.

    Raises:
        DgsError: REQUEST_INVALID: it cannot be read, is damaged or of another version; WRONG_HAND.
    """
    try:
        data = load_arrays(path)
        check_hand(str(data.get("hand", DEFAULT)), f"the grasps of {path}")
        version = int(data.get("version", 0))
        if version != VERSION:
            raise ValueError(f"it has version {version}, this program reads {VERSION}")
        return _consistent(_from_arrays(data))
    except (OSError, ValueError, KeyError, IndexError, TypeError) as error:
        what = f"the dataset {path} cannot be read: {error}"
        raise DgsError(ErrorCode.REQUEST_INVALID, what) from error


def _from_arrays(data: Mapping[str, NDArray]) -> GraspDataset:
    poses = transform(_quaternions_from_int(data["scene_rotation"]), data["scene_position"])
    objects, grasps = data["scene_object_count"], data["scene_grasp_count"]
    parts = [pieces(data["scene_objects"].astype(np.int64), objects), pieces(poses, objects)]
    gap = data.get("grasp_gap", np.full((len(data["grasp_fingers"]), HAND.finger_count), _UNKNOWN))
    for name in ("instance", "grasp", "symmetry"):
        parts.append(pieces(data[f"scene_{name}"].astype(np.int64), grasps))
    return GraspDataset(
        objects=catalogue_from_arrays(data),
        first=data["first"].astype(np.int64),
        grasps=object_grasps(
            data["grasp_position"] * POSITION_STEP,
            _quaternions_from_int(data["grasp_rotation"]),
            _joints_from_int(data["grasp_joints"]),
            finger_pattern(data["grasp_fingers"]),
            np.array(SOURCES)[data["grasp_source"].astype(int)],
            _joints_from_int(data["grasp_before"]),
        ),
        friction=np.where(data["grasp_friction"] > 0, data["grasp_friction"] / 100.0, np.nan),
        gap=np.where(gap == _UNKNOWN, np.nan, gap * GAP_STEP),
        scenes=[SceneGrasps(*scene) for scene in zip(*parts, strict=True)],
        drawn=data["drawn"].astype(np.int64),
        trials=data["trials"].astype(np.int64),
    )


def _consistent(data: GraspDataset) -> GraspDataset:
    """The dataset. Raises ValueError or IndexError where its tables do not belong together."""
    counts = np.diff(data.first)
    if data.first[0] != 0 or not len(data.objects) == len(counts) == len(data.drawn) == len(data.trials):
        raise ValueError(f"its tables are not all of its {len(data.objects)} objects")
    for of_each_grasp in (data.grasps.position, data.friction, data.gap):
        pieces(of_each_grasp, counts)
    for scene in data.scenes:
        if (scene.grasp >= counts[scene.objects][scene.instance]).any():
            raise ValueError("a scene has grasps that its objects have not")
    return data
