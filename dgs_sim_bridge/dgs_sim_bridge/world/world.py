"""The tabletop world in PyBullet; its frame is `base_link`, and objects move by contact only."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from dgs_description.cell import CELL, HOME_ARM
from dgs_description.frames import BASE_LINK, Array, apply, from_quaternion, inverse
from dgs_description.hand import HAND
from dgs_description.joints import ARM_EFFORT, ARM_JOINTS
from dgs_description.urdf import urdf_path
from dgs_sim_bridge.render.meshes import link_meshes
from dgs_sim_bridge.render.object_model import GLASS, OPAQUE, ObjectModel
from dgs_sim_bridge.render.pictures import palette
from dgs_sim_bridge.render.raster import box_mesh
from dgs_sim_bridge.render.shot import Stage
from dgs_sim_bridge.world.camera import Snapshot
from dgs_sim_bridge.world.hand_drive import HandDrive
from dgs_sim_bridge.world.physics import (
    PHYSICS,
    HandController,
    JointMotors,
    add_object,
    body_pose,
    change_links,
    new_world,
)
from dgs_sim_bridge.world.scenes import PlacedObject, choose_models, drop_scene
from dgs_sim_bridge.world.trajectory import ArmState

ARM_GAINS = (0.6, 1.0)
"""Shares of the position and of the velocity error that an arm motor removes per time step: stiff, as a UR is."""
LIFTED = 0.10
"""An object in the hand counts as held when its lowest point is this far above the table [m]."""
_FLAGS = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_MAINTAIN_LINK_ORDER


@dataclass(frozen=True)
class ObjectState:
    """Ground truth of one object: pose in `base_link`, and "table", "bin", "held" or "floor"."""

    name: str
    pose: Array
    place: str


def random_scene(
    catalogue: Sequence[ObjectModel], count: int, seed: int, transparent: float = 0.0
) -> list[PlacedObject]:
    """A settled random scene of `count` objects, poses in `base_link`; the same seed gives the same scene.

    A share `transparent` of the objects is glass; they lie as they would if they were not.

    Raises:
        DgsError: the count is out of range, the catalogue is empty, or objects would not stay on the table.
    """
    rng = np.random.default_rng(seed)
    models = choose_models(catalogue, count, rng)
    for k in np.random.default_rng([seed, 1]).permutation(count)[: round(transparent * count)]:
        models[k] = replace(models[k], material=GLASS)
    return [PlacedObject(item.model, CELL.T_base_table @ item.pose) for item in drop_scene(models, rng)]


class World:
    """One PyBullet world from its start to `close`. A new scene is a new world: a used one is not reproducible.

    Attributes:
        arm: motors of the arm.
        hand: the hand's firmware.
        time: simulated time [s].
        objects: the objects, in the order of `object_states`.
    """

    def __init__(
        self,
        objects: Sequence[PlacedObject] = (),
        arm_joints: ArrayLike = HOME_ARM,
        hand_joints: ArrayLike = HAND.straight,
        start_time: float = 0.0,
    ) -> None:
        """Build it.

        Args:
            objects: with poses in `base_link`.
            arm_joints: (6,) start [rad].
            hand_joints: (J,) start [rad].
            start_time: of the clock [s].
        """
        self.time = start_time
        self._bullet = new_world()
        self._bullet.setGravity(0, 0, -PHYSICS.gravity)
        self._robot = self._load("robot")
        self._surroundings = self._load("surroundings")
        self._add_floor()
        change_links(self._bullet, self._robot, lateralFriction=PHYSICS.hand_friction)
        change_links(self._bullet, self._surroundings, lateralFriction=PHYSICS.table_friction)
        self.arm = JointMotors(self._bullet, self._robot, ARM_JOINTS, ARM_EFFORT, ARM_GAINS)
        self.arm.reset(arm_joints)
        self.hand = HandDrive(HandController(self._bullet, self._robot), hand_joints)
        self.objects = tuple(item.model for item in objects)
        self._bodies = [add_object(self._bullet, item.model, item.pose) for item in objects]
        self._links = self._find_links()

    def close(self) -> None:
        """Free the PyBullet client; the world is of no use afterwards."""
        with suppress(pybullet.error):
            self._bullet.disconnect()

    def step(self) -> None:
        """One physics step."""
        self.hand.step(PHYSICS.time_step)
        self._bullet.stepSimulation()
        self.time += PHYSICS.time_step

    def arm_state(self) -> ArmState:
        """What the sensors of the arm's joints say."""
        return ArmState(*self.arm.state())

    def wrench(self) -> Array:
        """(6,) force [N] and torque about its origin [Nm] of all that touches the hand, in the frame "tool0"."""
        T_tool0_base = inverse(self.link_pose("tool0"))
        first = self._links["tool0"][1]
        total = np.zeros(6)
        for point in self._bullet.getContactPoints(self._robot):
            if point[2] == self._robot or point[3] < first:
                continue
            force = T_tool0_base[:3, :3] @ (
                point[9] * np.array(point[7])
                + point[10] * np.array(point[11])
                + point[12] * np.array(point[13])
            )
            total += np.concatenate([force, np.cross(apply(T_tool0_base, np.array(point[5])), force)])
        return total

    def table_force(self) -> float:
        """Sum of the normal forces between the robot and the cell [N]."""
        return sum(point[9] for point in self._bullet.getContactPoints(self._robot, self._surroundings))

    def object_states(self) -> list[ObjectState]:
        """Ground truth of every object."""
        placed = [(m, b, body_pose(self._bullet, b)) for m, b in zip(self.objects, self._bodies, strict=True)]
        return [ObjectState(model.name, pose, self._place(model, body, pose)) for model, body, pose in placed]

    def snapshot(self) -> Snapshot:
        """What the camera would see now."""
        visible = [mesh for mesh in link_meshes() if mesh.link in self._links]
        poses = [self.link_pose(mesh.link) for mesh in visible]
        poses += [body_pose(self._bullet, body) for body in self._bodies]
        meshes = [mesh.mesh for mesh in visible] + [model.mesh for model in self.objects]
        materials = [OPAQUE] * len(visible) + [model.material for model in self.objects]
        floor = box_mesh((-3.0, -3.0, CELL.floor_height - 0.1), (3.0, 3.0, CELL.floor_height))
        colours = [(255 * r, 255 * g, 255 * b) for r, g, b in (mesh.colour for mesh in visible)]
        colours += palette(len(self.objects))
        return Snapshot(Stage(meshes, poses, materials, floor), tuple(colours), self.time)

    def link_pose(self, link: str) -> Array:
        """(4, 4) pose of a link's frame in `base_link`, e.g. of "hand_tcp"."""
        body, index = self._links[link]
        if index < 0:
            return np.eye(4)
        state = self._bullet.getLinkState(body, index, computeForwardKinematics=1)
        return from_quaternion(state[4], state[5])

    def _load(self, name: str) -> int:
        path = str(urdf_path(name))
        return self._bullet.loadURDF(path, useFixedBase=True, flags=_FLAGS)

    def _add_floor(self) -> None:
        box, half = pybullet.GEOM_BOX, [3.0, 3.0, 0.05]
        shape = self._bullet.createCollisionShape(box, halfExtents=half)
        middle = [0, 0, CELL.floor_height - half[2]]
        self._bullet.createMultiBody(0, shape, basePosition=middle)

    def _find_links(self) -> dict[str, tuple[int, int]]:
        links = {BASE_LINK: (self._robot, -1)}
        for body in (self._robot, self._surroundings):
            for k in range(self._bullet.getNumJoints(body)):
                links[self._bullet.getJointInfo(body, k)[12].decode()] = (body, k)
        return links

    def _place(self, model: ObjectModel, body: int, T_base_object: Array) -> str:
        lowest = float((model.vertices @ T_base_object[2, :3]).min() + T_base_object[2, 3])
        above = lowest - CELL.table_height
        touching = self._bullet.getContactPoints(bodyA=body)
        touched = {contact[2] for contact in touching if contact[8] < 1e-3}
        if above >= LIFTED and self._robot in touched:
            return "held"
        bin_half = np.array(CELL.bin_size[:2]) / 2
        if np.all(np.abs(T_base_object[:2, 3] - CELL.bin_centre) <= bin_half) and above > -0.01:
            # Above the rim it may lie on the heap, or be on its way down.
            return "bin" if above < CELL.bin_size[2] or touched else "table"
        return "floor" if above < -0.02 else "table"
