"""Reads a hand's folder: `hand.yaml`, checked, becomes a `HandModel`. The fields are explained in docs/your_hand.md."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.frames import Array, transform
from dgs_description.hand_facts import Capsule, GraspFacts, Index, LevelPinch, LinkFacts, Mask
from dgs_description.hand_model import JOINTS_PER_FINGER, HandModel
from dgs_description.yaml_text import load_yaml

HANDS = Path(__file__).resolve().parent / "hands"
FILE = "hand.yaml"
LOCK_TORQUE = 20.0
"""By which a simulated joint that does not move is held [Nm]."""
LINKS = ("knuckle", "proximal", "middle", "distal")
"""Of every finger: `thumb_knuckle` ... `little_distal`; `thumb_tip` ... are the fingertip frames."""
_KEYS = (
    "name", "title", "mount", "mount_rpy", "tcp", "approach", "speed", "damping", "friction", "palm", "links",
    "lengths", "joints", "axes", "fingers", "grasp", "protocol",
)  # fmt: skip
_AXES = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
"""Of joint1 (yaw) to joint4, unless the file says otherwise."""


def hand_names() -> list[str]:
    """Names of the hands that come with the package."""
    return sorted(path.parent.name for path in HANDS.glob(f"*/{FILE}"))


def load_hand(name: str | Path) -> HandModel:
    """The hand of a folder.

    Args:
        name: of one of `hand_names`, or a path of a folder of one's own.

    Raises:
        DgsError: DESCRIPTION_MISSING, there is no such folder; PARAMETER_INVALID, the file says something impossible.
    """
    folder = Path(name) if "/" in str(name) else HANDS / str(name)
    path = folder / FILE
    try:
        return hand_of(load_yaml(path.read_text(encoding="utf-8")), folder.resolve().name)
    except (FileNotFoundError, NotADirectoryError) as error:
        known = f"{', '.join(hand_names())}, or a folder of your own by its path, such as ./{folder.name}"
        missing = f"no hand {str(name)!r}: {path} is missing; there are {known}"
        raise DgsError(ErrorCode.DESCRIPTION_MISSING, missing) from error
    except (yaml.YAMLError, UnicodeDecodeError, OSError) as error:
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"{path} cannot be read: {error}") from error
    except ValueError as error:
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"{path}: {error}") from error


def hand_of(contents: Any, name: str) -> HandModel:
    """The hand of a file's contents, in a folder of that name. Raises ValueError: they say something impossible."""
    file = _Node(contents, "")
    file.of(_KEYS)
    if file["name"].value != name:
        raise file["name"].wrong(f"is {file['name'].value!r}, the folder's name is {name!r}")
    fingers = _names(file["fingers"])
    parts = [_Finger(file, file["fingers"][finger]) for finger in fingers]
    joints = tuple(f"{finger}_joint{k + 1}" for finger in fingers for k in range(JOINTS_PER_FINGER))
    source, ratio = np.arange(len(joints)), np.ones(len(joints))
    for f, part in enumerate(parts):
        for k, (leader, factor) in part.follows.items():
            row = JOINTS_PER_FINGER * f + k
            own = f"{fingers[f]}_{leader.value}"
            leads = own if own in joints else leader.value
            source[row], ratio[row] = _Node(leads, leader.where).one_of(joints), factor
            if source[row] == row:
                raise leader.wrong("names the joint itself")
    if (source[source] != source).any():
        raise file["joints"].wrong("has a joint that follows one that follows another")
    lower, upper = (np.concatenate([getattr(part, end) for part in parts]) for end in ("lower", "upper"))
    _narrow(lower, upper, source, ratio, joints)
    yaws = np.stack([lower, upper], axis=1)[::JOINTS_PER_FINGER].tolist()
    palm, links = file["palm"], file["links"]
    palm.of(["mass", "centre_of_mass", "boxes"])
    links.of(LINKS)
    links["knuckle"].of(["mass", "centre_of_mass"])
    approach = Rotation.from_euler("y", file.get("approach", _Node(0.0, "approach")).number())
    mount = Rotation.from_euler("xyz", file.get("mount_rpy", _Node([0.0] * 3, "mount_rpy")).numbers(3))
    return HandModel(
        name=name,
        title=str(file["title"].value),
        fingers=fingers,
        lower=lower,
        upper=upper,
        effort=np.concatenate([part.effort for part in parts]),
        source=source,
        ratio=ratio,
        locked=np.concatenate([part.locked for part in parts]),
        speed=file["speed"].number(0.01),
        damping=file["damping"].number(0.0),
        friction=file["friction"].number(0.0),
        T_mount_base=transform(mount.as_matrix(), file["mount"].numbers(3)),
        T_base_tcp=transform(approach.as_matrix(), file["tcp"].numbers(3)),
        bases=np.stack([part.pose for part in parts]),
        axes=np.stack([part.axes for part in parts]),
        steps=np.stack([part.steps for part in parts]),
        spread=np.array([_spread(file["fingers"][f], *yaw) for f, yaw in zip(fingers, yaws, strict=True)]),
        capsules=tuple(part.capsules for part in parts),
        spheres=tuple(links[link]["spheres"].count(2) for link in LINKS[1:]),
        palm=_link(palm),
        palm_boxes=_boxes(palm["boxes"]),
        links=tuple(_link(links[link]) for link in LINKS),
        grasp=_grasp(file["grasp"], fingers, lower[1::JOINTS_PER_FINGER], upper[1::JOINTS_PER_FINGER]),
        protocol=_protocol(file),
    )


class _Node:
    """A part of the file that remembers where it stands, for messages."""

    def __init__(self, value: Any, where: str):
        self.value, self.where = value, where

    def wrong(self, what: str) -> ValueError:
        return ValueError(f"{self.where or 'the file'} {what}")

    def __getitem__(self, key: str) -> _Node:
        if not isinstance(self.value, Mapping):
            raise self.wrong("must be a mapping")
        if key not in self.value:
            raise self.wrong(f"lacks {key!r}")
        return _Node(self.value[key], f"{self.where}.{key}".lstrip("."))

    def get(self, key: str, default: _Node) -> _Node:
        """A key's part, or `default` where it is left out."""
        return self[key] if isinstance(self.value, Mapping) and key in self.value else default

    def of(self, allowed: Sequence[str]) -> None:
        """Refuse what is no mapping, and keys that mean nothing here."""
        if not isinstance(self.value, Mapping):
            raise self.wrong("must be a mapping")
        unknown = sorted(map(str, set(self.value) - set(allowed)))
        if unknown:
            raise self.wrong(f"has unknown keys: {', '.join(unknown)}; known are {', '.join(allowed)}")

    def items(self, count: int | None = None) -> list[_Node]:
        if not isinstance(self.value, list) or (count is not None and len(self.value) != count):
            raise self.wrong(f"must be a list{'' if count is None else f' of {count}'}")
        return [_Node(value, f"{self.where}[{k}]") for k, value in enumerate(self.value)]

    def number(self, least: float = -np.inf) -> float:
        if isinstance(self.value, bool) or not isinstance(self.value, (int, float)):
            raise self.wrong("must be a number")
        if not abs(self.value) <= sys.float_info.max or self.value < least:
            raise self.wrong(
                f"must be a finite number{'' if least == -np.inf else f' of at least {least:g}'}"
            )
        return float(self.value)

    def count(self, least: int) -> int:
        if self.number(least) != int(self.value):
            raise self.wrong("must be a whole number")
        return int(self.value)

    def numbers(self, count: int, least: float = -np.inf) -> Array:
        return np.array([item.number(least) for item in self.items(count)])

    def unit(self) -> Array:
        vector = self.numbers(3)
        if np.linalg.norm(vector) < 1e-6:
            raise self.wrong("must not be zero")
        return vector / np.linalg.norm(vector)

    def one_of(self, names: Sequence[str]) -> int:
        if self.value not in names:
            raise self.wrong(f"names {self.value!r}; there are {', '.join(names)}")
        return names.index(self.value)


def _protocol(file: _Node) -> str:
    if "protocol" not in file.value:
        return ""
    node = file["protocol"]
    if not isinstance(node.value, str) or not re.fullmatch(r"[\w.]+:\w+", node.value):
        raise node.wrong("must be `module:Class`, a Python class derived from HandProtocol")
    return node.value


def _names(fingers: _Node) -> tuple[str, ...]:
    if not isinstance(fingers.value, Mapping) or not 2 <= len(fingers.value) <= 5:
        raise fingers.wrong("must be a mapping of two to five fingers, the thumb first")
    for name in fingers.value:
        if not isinstance(name, str) or not name.isidentifier() or "_" in name:
            raise fingers.wrong(f"has the finger {name!r}; letters and digits only")
    return tuple(fingers.value)


def _narrow(lower: Array, upper: Array, source: Index, ratio: Array, joints: Sequence[str]) -> None:
    """Narrow the limits of every joint that leads to what those allow that follow it."""
    for row in np.flatnonzero(source != np.arange(len(source))).tolist():
        leader = int(source[row])
        low, high = sorted(np.array([lower[row], upper[row]]) / ratio[row])
        lower[leader], upper[leader] = max(lower[leader], low), min(upper[leader], high)
        if lower[leader] > upper[leader]:
            raise ValueError(
                f"{joints[row]} follows {joints[leader]}, but their limits have nothing in common"
            )


def _spread(finger: _Node, lower: float, upper: float) -> float:
    """A finger's yaw in the open hand, within the limits of joint1; unless it is said as near to 0 as they allow."""
    spread = finger.get("spread", _Node(min(max(0.0, lower), upper), "spread")).number()
    if not lower - 1e-9 <= spread <= upper + 1e-9:
        raise finger["spread"].wrong("lies outside of joint1's limits")
    return spread


def _boxes(node: _Node) -> Array:
    """(B, 6) boxes, one at least, none turned inside out."""
    boxes = node.items()
    if not boxes:
        raise node.wrong("must name one box at least")
    for box in boxes:
        low, high = box.numbers(6).reshape(3, 2).T
        if (high <= low).any():
            raise box.wrong("must be x0, x1, y0, y1, z0, z1 with x0 below x1 and so on")
    return np.stack([box.numbers(6) for box in boxes])


def _link(node: _Node) -> LinkFacts:
    x, y, z = node["centre_of_mass"].numbers(3).tolist()
    return LinkFacts(node["mass"].number(1e-6), (x, y, z))


class _Finger:
    """One finger; what it does not say of its own, the file says for all."""

    def __init__(self, file: _Node, own: _Node):
        own.of(["place", "distal", "palmar", "spread", "lengths", "joints", "axes", "links"])
        y, palmar = own["distal"].unit(), own["palmar"].unit()
        z = palmar - (palmar @ y) * y
        if np.linalg.norm(z) < 0.1:
            raise own["palmar"].wrong("points along the finger; it must point to where the finger bends")
        z /= np.linalg.norm(z)
        self.pose = transform(np.stack([np.cross(y, z), y, z], axis=-1), own["place"].numbers(3))
        lengths = own.get("lengths", file["lengths"]).items(JOINTS_PER_FINGER)
        self.steps = np.stack([_step(length) for length in lengths])
        axes = own.get("axes", file.get("axes", _Node([list(axis) for axis in _AXES], "axes")))
        self.axes = np.stack([axis.unit() for axis in axes.items(JOINTS_PER_FINGER)])
        self.lower, self.upper, self.effort = (np.zeros(JOINTS_PER_FINGER) for _ in range(3))
        self.locked = np.zeros(JOINTS_PER_FINGER, dtype=bool)
        self.follows: dict[int, tuple[_Node, float]] = {}
        for k, joint in enumerate(own.get("joints", file["joints"]).items(JOINTS_PER_FINGER)):
            self._joint(k, joint)
        links = own.get("links", _Node({}, "links"))
        links.of(LINKS[1:])
        self.capsules = tuple(
            _capsule(links.get(name, _Node({}, f"links.{name}")), file["links"][name]) for name in LINKS[1:]
        )

    def _joint(self, k: int, joint: _Node) -> None:
        joint.of(["lower", "upper", "effort", "follows", "ratio", "at"])
        if "at" in joint.value:
            if len(joint.value) > 1:
                raise joint["at"].wrong("goes with nothing else: the joint does not move")
            self.lower[k] = self.upper[k] = joint["at"].number()
            self.locked[k], self.effort[k] = True, LOCK_TORQUE
            return
        self.lower[k], self.upper[k] = joint["lower"].number(), joint["upper"].number()
        self.effort[k] = joint["effort"].number(1e-3)
        if self.lower[k] >= self.upper[k]:
            raise joint.wrong(
                "has a lower limit that is not below the upper one; a joint that does not move says `at`"
            )
        if "follows" in joint.value:
            self.follows[k] = joint["follows"], joint.get("ratio", _Node(1.0, "ratio")).number()
            if not self.follows[k][1]:
                raise joint["ratio"].wrong("must not be 0; a joint that does not move says `at`")
        elif "ratio" in joint.value:
            raise joint["ratio"].wrong("needs a `follows`")


def _step(length: _Node) -> Array:
    """The way to the next joint: a length along the finger, or all three coordinates."""
    return length.numbers(3) if isinstance(length.value, list) else np.array([0.0, length.number(0.0), 0.0])


def _capsule(link: _Node, common: _Node) -> Capsule:
    """The capsule of one finger's link: what it does not say itself, the file says for all."""
    shape = ["radius", "from", "to", "height"]
    link.of(shape)
    common.of(["mass", "centre_of_mass", *shape, "spheres"])
    radius = common["radius"].number(1e-3)
    if "radius" in link.value and link["radius"].number() != radius:
        raise link["radius"].wrong(
            f"must be the {radius:g} of the other fingers: radii are the same in all fingers"
        )
    start, end = (link.get(key, common[key]).number() for key in ("from", "to"))
    if end < start:
        raise link.wrong("ends before it starts")
    return Capsule(radius, start, end, link.get("height", common["height"]).number())


def _grasp(node: _Node, fingers: tuple[str, ...], lower: Array, upper: Array) -> GraspFacts:
    """`lower`, `upper`: (F,) limits of joint2 [rad]."""
    count = len(fingers)
    node.of([field.name for field in fields(GraspFacts)])

    def mask(names: _Node) -> Mask:
        rows = [name.one_of(fingers) for name in names.items()]
        return np.isin(np.arange(count), rows)

    patterns = np.stack([mask(pattern) for pattern in node["patterns"].items(count - 1)])
    if not patterns[:, 0].all() or (patterns.sum(axis=1) != np.arange(2, count + 1)).any():
        raise node["patterns"].wrong(
            "must name two fingers, then three and so on, the thumb always among them"
        )
    level = push = None
    if "level_pinch" in node.value:
        facts = node["level_pinch"]
        facts.of(["fingers", "thumb_between", "thumb_shift", "lean"])
        between = tuple(name.one_of(fingers) for name in facts["thumb_between"].items())
        if not between:
            raise facts["thumb_between"].wrong("must name one finger at least")
        active = mask(facts["fingers"])
        if not active[0] or active.sum() < 2:
            raise facts["fingers"].wrong("must name the thumb and another finger at least")
        level = LevelPinch(active, between, facts["thumb_shift"].number(), facts["lean"].number())
    if "push" in node.value:
        facts = node["push"]
        facts.of(["fingers", "bend"])
        first, second = (name.one_of(fingers) for name in facts["fingers"].items(2))
        if first == second:
            raise facts["fingers"].wrong("must name two fingers")
        bend = facts["bend"].numbers(count)
        beyond = np.flatnonzero((bend < lower - 1e-9) | (bend > upper + 1e-9))
        if len(beyond):
            raise facts["bend"].wrong(f"is beyond the limits of joint2 of {fingers[beyond[0]]}")
        push = ((first, second), bend)
    return GraspFacts(
        widest=node["widest"].number(0.01),
        pre_grasp=node["pre_grasp"].numbers(JOINTS_PER_FINGER),
        beyond=node["beyond"].numbers(JOINTS_PER_FINGER),
        patterns=patterns,
        tip_plane=node["tip_plane"].number(),
        tip_delta=node["tip_delta"].numbers(count),
        circle=node["circle"].numbers(count),
        rectangle=node["rectangle"].numbers(count),
        thumb_share=node["thumb_share"].number(0.0),
        level_pinch=level,
        push=push,
        stiffness=node["stiffness"].numbers(JOINTS_PER_FINGER, 1e-3),
        thumb_factor=node["thumb_factor"].number(0.1),
    )
