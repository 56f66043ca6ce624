"""Links, joints and primitive shapes of a robot description, their inertias, and how they become URDF text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, NamedTuple
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike

from dgs_description.frames import Array, from_rpy

if TYPE_CHECKING:
    import pinocchio

Vector = tuple[float, float, float]

HEADER = " Written by `python -m dgs_description.urdf`: change that package's Python, not this file. "
FRAME_MASS = 1e-3
"""Mass of links that are frames only [kg]: PyBullet gives 1 kg to a link that states none."""


@dataclass(frozen=True)
class Box:
    """Box of edge lengths `size` [m] at `centre` in the link's frame."""

    size: Vector
    centre: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Cylinder:
    """Cylinder along its own z, `length` between the flat ends [m]."""

    radius: float
    length: float
    centre: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class CapsuleShape:
    """All points within `radius` of the segment from `start` to `end` in the link's frame [m]."""

    radius: float
    start: Vector
    end: Vector

    @property
    def length(self) -> float:
        """Length of the segment [m]."""
        return float(np.linalg.norm(np.subtract(self.end, self.start)))

    @property
    def centre(self) -> Vector:
        """Middle of the segment [m]."""
        x, y, z = (np.add(self.start, self.end) / 2).tolist()
        return (x, y, z)

    @property
    def rpy(self) -> Vector:
        """Fixed-axis angles that turn z into the segment's direction [rad]."""
        dx, dy, dz = np.subtract(self.end, self.start)
        flat = float(np.hypot(dx, dy))
        return (0.0, float(np.arctan2(flat, dz)), float(np.arctan2(dy, dx)) if flat > 1e-12 else 0.0)


Shape = Box | Cylinder | CapsuleShape


@dataclass(frozen=True)
class Link:
    """A rigid part.

    Attributes:
        name: of the link.
        shapes: solid primitives; used for collision, for the picture and for the inertia.
        mass: [kg].
        centre_of_mass: in the link's frame [m]; None = that of the shapes at uniform density.
        colour: red, green, blue in 0..1.
    """

    name: str
    shapes: tuple[Shape, ...] = ()
    mass: float = FRAME_MASS
    centre_of_mass: Vector | None = None
    colour: Vector = (0.7, 0.7, 0.7)


@dataclass(frozen=True)
class Limit:
    """Limits of a turning joint: angles [rad], torque [Nm], speed [rad/s]."""

    lower: float
    upper: float
    effort: float
    velocity: float


class Mimic(NamedTuple):
    """A joint whose angle times `multiplier` another one copies."""

    joint: str
    multiplier: float


@dataclass(frozen=True)
class Joint:
    """A joint; fixed without `axis`. `xyz` [m] and `rpy` [rad] give the child's frame in the parent's at angle zero."""

    name: str
    parent: str
    child: str
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    axis: Vector | None = None
    limit: Limit | None = None
    damping: float = 0.0
    friction: float = 0.0
    mimic: Mimic | None = None


@dataclass(frozen=True)
class Robot:
    """A tree of links; the first link is its root, and every joint comes after the one that its parent hangs from."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]

    def __add__(self, other: Robot) -> Robot:
        return Robot(self.name, self.links + other.links, self.joints + other.joints)


def inertia(link: Link) -> tuple[Array, Array]:
    """Centre of mass (3,) [m] and inertia (3, 3) about it [kg m^2] of a link.

    The tensor is that of the link's shapes at uniform density, about their centroid. A link without shapes counts as
    a ball of 1 cm radius.
    """
    import pinocchio  # only those who write the files need it

    solids = [
        _solid(shape).se3Action(pinocchio.SE3(from_rpy(shape.centre, shape.rpy))) for shape in link.shapes
    ]
    body = sum(solids, start=pinocchio.Inertia.Zero()) if solids else pinocchio.Inertia.FromSphere(1.0, 0.01)
    com = body.lever if link.centre_of_mass is None else np.array(link.centre_of_mass)
    return com, body.inertia * link.mass / body.mass


def _solid(shape: Shape) -> pinocchio.Inertia:
    """Inertia of a shape of density 1 kg/m^3 in its own axes."""
    import pinocchio

    if isinstance(shape, Box):
        return pinocchio.Inertia.FromBox(float(np.prod(shape.size)), *shape.size)
    volume = np.pi * shape.radius**2 * shape.length
    if isinstance(shape, Cylinder):
        return pinocchio.Inertia.FromCylinder(volume, shape.radius, shape.length)
    volume += 4 / 3 * np.pi * shape.radius**3
    return pinocchio.Inertia.FromCapsule(volume, shape.radius, shape.length)


def to_urdf(robot: Robot, *, capsules: bool = True, visuals: bool = True) -> str:
    """URDF text of a robot.

    Args:
        capsules: True writes `<capsule>` (URDF 1.2: PyBullet, pinocchio with urdfdom >= 5); False writes URDF 1.0
            with a cylinder and two spheres instead and no inertia on the root, which every ROS tool reads.
        visuals: whether to write the shapes a second time as `<visual>`.
    """
    root = ElementTree.Element("robot", name=robot.name, version="1.2" if capsules else "1.0")
    root.append(ElementTree.Comment(HEADER))
    for link in robot.links:
        element = ElementTree.SubElement(root, "link", name=link.name)
        if capsules or link is not robot.links[0]:
            _add_inertial(element, link)
        for kind in ("visual", "collision") if visuals else ("collision",):
            _add_shapes(element, kind, link, capsules)
    for joint in robot.joints:
        _add_joint(root, joint)
    ElementTree.indent(root, "  ")
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _numbers(values: ArrayLike) -> str:
    # Twelve digits keep frames within 1e-11 m and are the same on every machine; adding 0.0 turns -0 into 0.
    return " ".join(f"{value + 0.0:.12g}" for value in np.where(np.abs(values) < 1e-14, 0.0, values))


def _add_origin(element: ElementTree.Element, xyz: Sequence[float], rpy: Sequence[float] = (0, 0, 0)) -> None:
    if np.any(xyz) or np.any(rpy):
        ElementTree.SubElement(element, "origin", xyz=_numbers(xyz), rpy=_numbers(rpy))


def _add_inertial(element: ElementTree.Element, link: Link) -> None:
    com, tensor = inertia(link)
    inertial = ElementTree.SubElement(element, "inertial")
    _add_origin(inertial, com.tolist())
    ElementTree.SubElement(inertial, "mass", value=f"{link.mass:.6g}")
    entries = {f"i{'xyz'[i]}{'xyz'[j]}": f"{tensor[i, j]:.5e}" for i in range(3) for j in range(i, 3)}
    negligible = tensor.max() * 1e-9
    for i, j in ((0, 1), (0, 2), (1, 2)):
        if abs(tensor[i, j]) < negligible:
            entries[f"i{'xyz'[i]}{'xyz'[j]}"] = "0"
    ElementTree.SubElement(inertial, "inertia", entries)


def _add_shapes(element: ElementTree.Element, kind: str, link: Link, capsules: bool) -> None:
    for shape in link.shapes:
        for tag, attributes, xyz, rpy in _primitives(shape, capsules):
            part = ElementTree.SubElement(element, kind)
            _add_origin(part, xyz, rpy)
            ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), tag, attributes)
            if kind == "visual":
                name = "colour_" + "_".join(f"{round(100 * value)}" for value in link.colour)
                material = ElementTree.SubElement(part, "material", name=name)
                ElementTree.SubElement(material, "color", rgba=_numbers([*link.colour, 1.0]))


def _primitives(shape: Shape, capsules: bool) -> list[tuple[str, dict[str, str], Vector, Vector]]:
    if isinstance(shape, Box):
        return [("box", {"size": _numbers(shape.size)}, shape.centre, shape.rpy)]
    tube = {"radius": _numbers([shape.radius]), "length": _numbers([shape.length])}
    if isinstance(shape, Cylinder):
        return [("cylinder", tube, shape.centre, shape.rpy)]
    if capsules:
        return [("capsule", tube, shape.centre, shape.rpy)]
    ball = {"radius": tube["radius"]}
    still = (0.0, 0.0, 0.0)
    return [
        ("cylinder", tube, shape.centre, shape.rpy),
        ("sphere", ball, shape.start, still),
        ("sphere", ball, shape.end, still),
    ]


def _add_joint(root: ElementTree.Element, joint: Joint) -> None:
    kind = "fixed" if joint.axis is None else "revolute"
    element = ElementTree.SubElement(root, "joint", name=joint.name, type=kind)
    ElementTree.SubElement(element, "parent", link=joint.parent)
    ElementTree.SubElement(element, "child", link=joint.child)
    _add_origin(element, joint.xyz, joint.rpy)
    if joint.axis is not None:
        ElementTree.SubElement(element, "axis", xyz=_numbers(joint.axis))
    if joint.limit is not None:
        limits = {key: _numbers([value]) for key, value in asdict(joint.limit).items()}
        ElementTree.SubElement(element, "limit", limits)
    if joint.damping or joint.friction:
        dynamics = {"damping": _numbers([joint.damping]), "friction": _numbers([joint.friction])}
        ElementTree.SubElement(element, "dynamics", dynamics)
    if joint.mimic is not None:
        multiplier = _numbers([joint.mimic.multiplier])
        ElementTree.SubElement(element, "mimic", joint=joint.mimic.joint, multiplier=multiplier, offset="0")
