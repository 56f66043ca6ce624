"""The carried hand in MuJoCo: a second judge, which shares no contact model with PyBullet."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
import trimesh
from mujoco import mjtEq, mjtGeom, mjtJoint, mjtObj
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from dgs_description.frames import Array, inverse, transform
from dgs_description.hand import HAND
from dgs_description.urdf import urdf_path
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.hand_world import CARRIER_FORCE, HandWorld, Wear
from dgs_sim_bridge.world.physics import PHYSICS
from dgs_sim_bridge.world.scenes import table_top

TIME_STEP = 0.001
"""[s]; half of it gives the same verdicts."""
STEPS = 4
"""Physics steps in a control period."""
SOLREF, SOLIMP = (0.004, 1.0), (0.95, 0.99, 0.0005, 0.5, 2.0)
"""Contacts as stiff as the time step allows."""
TORSION = 0.005
"""Friction of an 11 mm fingertip against spinning [m]; nothing but its facets keeps a thing from rolling here."""
STIFFNESS, DAMPING = 60.0, 0.6
"""Of the motors' position loop [Nm/rad, Nms/rad], inside the torque limits."""
ARMATURE, DRAG = PHYSICS.finger_inertia, 0.001
"""Reflected rotor inertia [kg m^2] and damping [Nms/rad] of a joint."""
CARRIER_MASS, CARRIER_STIFFNESS, CARRIER_DAMPING = 3.0, 2e5, 2e3
"""Of the arm, as the hand feels it in each direction [kg, N/m, Ns/m]."""
HAND_BIT, OBJECT, TABLE = 1, 2, 4
"""Bits of what collides: nothing of the hand with itself."""
_PALM = HAND.finger_count
FAR = 100.0
"""Where removed objects are put [m]."""


class MujocoHandWorld(HandWorld):
    """See `HandWorld` and `open_world`. A coupling of joints is a constraint here."""

    period = TIME_STEP * STEPS

    def __init__(
        self,
        models: Sequence[ObjectModel],
        poses: Sequence[Array],
        table: bool,
        friction: float | None,
        wear: Wear | None,
        edge: float | None,
    ):
        super().__init__(models, wear)
        self._friction = PHYSICS.hand_friction if friction is None else friction
        self._table, self._edge = table, edge
        self._model = self._compile()
        self._data = mujoco.MjData(self._model)
        model = self._model
        self._q = np.array([model.joint(name).qposadr[0] for name in HAND.joints])
        self._v = np.array([model.joint(name).dofadr[0] for name in HAND.joints])
        self._motors = np.array([model.actuator(name).id for name in HAND.joints])
        self._carrier = model.body("hand_tcp").id
        slides = [model.joint(f"carrier{k}") for k in range(3 if table else 0)]
        self._slides = np.array([slide.qposadr[0] for slide in slides], dtype=int)
        self._slides_v = np.array([slide.dofadr[0] for slide in slides], dtype=int)
        self._carriers = np.array([model.actuator(slide.name).id for slide in slides], dtype=int)
        self._bodies = [model.body(f"object{k}").id for k in range(len(self.models))]
        self._free = [model.body(body).jntadr[0] for body in self._bodies]
        bodies = [model.body(body).name for body in model.geom_bodyid]
        hand = [model.geom(k).contype[0] == HAND_BIT for k in range(model.ngeom)]
        names = [body.split("_")[0] if mine else "" for body, mine in zip(bodies, hand, strict=True)]
        self._part = np.array(
            [HAND.fingers.index(n) if n in HAND.fingers else _PALM if n else -1 for n in names]
        )
        self._object = np.full(model.ngeom, -1)
        for index, body in enumerate(self._bodies):
            self._object[model.geom_bodyid == body] = index
        for index, pose in enumerate(poses):
            self.place(index, pose)
        self.put_hand(transform(position=(0.0, 0.0, 1.0)), np.zeros(HAND.joint_count))

    def _compile(self) -> mujoco.MjModel:
        spec = mujoco.MjSpec.from_file(str(urdf_path("floating_hand")))
        spec.compiler.fusestatic = False
        option = spec.option
        option.timestep = TIME_STEP
        option.gravity = (0.0, 0.0, -PHYSICS.gravity if self._table else 0.0)
        option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.impratio, option.iterations, option.tolerance = 10.0, 50, 1e-9
        for geom in spec.geoms:
            self._surface(geom, self._friction, HAND_BIT, OBJECT | TABLE)
        for name, effort in zip(HAND.joints, HAND.effort * self._wear.effort, strict=True):
            spec.joint(name).armature, spec.joint(name).damping = ARMATURE, (DRAG, 0.0, 0.0)
            _motor(spec, name, STIFFNESS, DAMPING, effort)
        for k in np.flatnonzero(HAND.source != np.arange(HAND.joint_count)):
            spec.add_equality(
                type=mjtEq.mjEQ_JOINT,
                objtype=mjtObj.mjOBJ_JOINT,
                name1=HAND.joints[k],
                name2=HAND.joints[HAND.source[k]],
                data=[0.0, HAND.ratio[k], *[0.0] * 10],
                solref=SOLREF,
                solimp=(0.95, 0.99, 0.001, 0.5, 2.0),
            )
        if self._table:
            self._add_table_and_carrier(spec)
        for index, model in enumerate(self.models):
            self._add_object(spec, index, model)
        return spec.compile()

    @staticmethod
    def _surface(geom: mujoco.MjsGeom, friction: float, kind: int, others: int) -> None:
        geom.condim, geom.friction = 4, (friction, TORSION, 0.0)
        geom.solref, geom.solimp = SOLREF, SOLIMP
        geom.contype, geom.conaffinity = kind, others

    def _add_table_and_carrier(self, spec: mujoco.MjSpec) -> None:
        for k, axis in enumerate(np.eye(3)):
            name, slide = f"carrier{k}", mjtJoint.mjJNT_SLIDE
            spec.body("hand_tcp").add_joint(name=name, type=slide, axis=axis, armature=CARRIER_MASS)
            _motor(spec, name, CARRIER_STIFFNESS, CARRIER_DAMPING, CARRIER_FORCE)
        if self._edge is None:
            top = spec.worldbody.add_geom(type=mjtGeom.mjGEOM_PLANE, size=(2.0, 2.0, 0.1))
        else:
            middle, half = table_top(self._edge)
            top = spec.worldbody.add_geom(type=mjtGeom.mjGEOM_BOX, pos=middle, size=half)
        self._surface(top, self._friction, TABLE, HAND_BIT | OBJECT)

    def _add_object(self, spec: mujoco.MjSpec, index: int, model: ObjectModel) -> None:
        body = spec.worldbody.add_body(name=f"object{index}")
        body.add_freejoint()
        body.explicitinertial = True
        body.mass, body.ipos, body.fullinertia = model.mass, (0.0, 0.0, 0.0), _inertia(model)
        for k, part in enumerate(model.parts):
            name = f"object{index}_{k}"
            spec.add_mesh(name=name, uservert=np.asarray(part, float).ravel())
            geom = body.add_geom(type=mjtGeom.mjGEOM_MESH, meshname=name)
            # Of two geoms MuJoCo takes the larger coefficient, or the one of higher priority: here the object's, which
            # is the product that Bullet takes.
            self._surface(geom, self._friction * model.friction, OBJECT, HAND_BIT | OBJECT | TABLE)
            geom.priority = 1

    def object_pose(self, index: int) -> Array:
        """(4, 4)."""
        return self._pose(self._bodies[index])

    def place(self, index: int, T_world_object: Array) -> None:
        """Put an object there, at rest."""
        at, speed = self._model.jnt_qposadr[self._free[index]], self._model.jnt_dofadr[self._free[index]]
        self._data.qpos[at : at + 3] = T_world_object[:3, 3]
        self._data.qpos[at + 3 : at + 7] = _wxyz(T_world_object)
        self._data.qvel[speed : speed + 6] = 0.0
        mujoco.mj_forward(self._model, self._data)

    def _vanish(self, index: int) -> None:
        mine = self._object == index
        self._model.geom_contype[mine] = self._model.geom_conaffinity[mine] = 0
        self.place(index, transform(position=(FAR, FAR, 0.0)))  # and falls

    def hand_pose(self) -> Array:
        """(4, 4) pose of the TCP."""
        return self._pose(self._carrier)

    def _pose(self, number: int) -> Array:
        body = self._data.body(number)
        return transform(body.xmat.reshape(3, 3).copy(), body.xpos)

    def _put(self, T_world_tcp: Array, joints: Array) -> None:
        self._T_world_start = T_world_tcp
        self._model.body_pos[self._carrier] = T_world_tcp[:3, 3]
        self._model.body_quat[self._carrier] = _wxyz(T_world_tcp)
        moving = np.r_[self._q, self._slides]
        self._data.qpos[moving] = np.r_[joints, np.zeros(len(self._slides))]
        self._data.qvel[np.r_[self._v, self._slides_v]] = 0.0
        self._data.ctrl[:] = 0.0
        self._command(joints)
        mujoco.mj_forward(self._model, self._data)

    def carry(self, T_world_tcp: Array) -> None:
        """Move the set point of the three slides."""
        self._data.ctrl[self._carriers] = inverse(self._T_world_start)[:3] @ [*T_world_tcp[:3, 3], 1.0]

    def _command(self, joints: Array) -> None:
        self._data.ctrl[self._motors] = joints

    def _state(self) -> tuple[Array, Array]:
        return self._data.qpos[self._q], self._data.actuator_force[self._motors]

    def contacts(self, index: int) -> set[int]:
        """Fingers, by number, that touch an object."""
        pairs = self._data.contact.geom.reshape(-1, 2)
        mine = (self._object[pairs] == index).any(1) & (self._part[pairs] >= 0).any(1)
        return set(self._part[pairs[mine]].max(1).tolist()) - {_PALM}

    def set_gravity(self, vector: ArrayLike) -> None:
        """(3,) [m/s^2]."""
        self._model.opt.gravity[:] = vector

    def set_friction(self, value: float) -> None:
        """Of hand on object; the object's coefficient is the one that counts (see `_add_object`)."""
        for index, model in enumerate(self.models):
            self._model.geom_friction[self._object == index, 0] = value * model.friction

    def _advance(self) -> None:
        mujoco.mj_step(self._model, self._data, STEPS)


def _motor(spec: mujoco.MjSpec, joint: str, stiffness: float, damping: float, effort: float) -> None:
    motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_position(kp=stiffness, kv=damping)
    motor.forcelimited, motor.forcerange = True, (-effort, effort)


def _inertia(model: ObjectModel) -> Array:
    """(6,) xx, yy, zz, xy, xz, yz about the frame's origin, of uniform density in the convex parts [kg m^2]."""
    solids = [trimesh.convex.convex_hull(np.asarray(part, float)) for part in model.parts]
    volume = sum(solid.volume for solid in solids)
    about = np.zeros((3, 3))
    for solid in solids:
        centre = solid.center_mass
        steiner = centre @ centre * np.eye(3) - np.outer(centre, centre)
        about += solid.moment_inertia + solid.volume * steiner
    about *= model.mass / volume
    return about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _wxyz(T: Array) -> Array:
    return Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
