"""A first hand folder from any hand's URDF: `python -m dgs_description.hand_import HAND.urdf FOLDER [--thumb NAME]`.

Joints, lengths, limits and couplings are taken over; from them follow the way of the approach, the TCP and where the
fingertips meet (`hand_stance`). What a URDF does not say (palm, masses, how fat the links are) is guessed, and printed
as such. Measure that, edit `hand.yaml`, and run `python -m dgs_description.hand_stance` again.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from dgs_description.errors import DgsError, ErrorCode
from dgs_description.files import atomic_write
from dgs_description.frames import Array, from_rpy
from dgs_description.hand_file import FILE, LINKS, hand_of
from dgs_description.hand_model import JOINTS_PER_FINGER
from dgs_description.hand_stance import Stance, best_stance, put, rounded

RADII = (0.011, 0.010, 0.010)
"""Of proximal, middle and distal link, guessed [m]."""
NAMES = ("thumb", "index", "middle", "ring", "little")
TIP = 0.025
"""Length of a last link without a fingertip frame, guessed [m]."""
BARE = 0.015
"""Ways from joint to joint without a shape, or so far beside it, are told of [m]."""
_exact = partial(rounded, digits=6)


@dataclass(frozen=True)
class _Joint:
    name: str
    place: Array
    axis: Array
    lower: float
    upper: float
    effort: float
    mimic: tuple[str, float] | None
    sign: int = 1


@dataclass(frozen=True)
class _Chain:
    """The moving joints of a finger, at angle zero in the root's frame, and where it ends."""

    joints: tuple[_Joint, ...]
    tip: Array
    guessed: bool

    def axes(self) -> Array:
        """(3, 3) F_i: x = last joint's axis, y = to the fingertip, z = to where the finger bends."""
        y = self.tip - self.joints[-1].place
        y = y / np.linalg.norm(y)
        x = self.joints[-1].axis - (self.joints[-1].axis @ y) * y
        if np.linalg.norm(x) < 1e-6:
            raise ValueError(f"{self.joints[-1].name} turns about its finger: it does not bend it")
        x = x / np.linalg.norm(x)
        return np.stack([x, y, np.cross(x, y)], axis=-1)


def import_hand(urdf: Path, name: str, thumb: str = "") -> tuple[dict[str, Any], list[str]]:
    """What `hand.yaml` shall say, and what had to be guessed.

    Args:
        urdf: of the hand alone.
        thumb: begins the name of the thumb's first joint; empty = the finger that bends most unlike the others.

    Raises:
        DgsError: PARAMETER_INVALID, no URDF, or no hand of two to five fingers of up to four joints that can pinch.
    """
    try:
        chains = _chains(ElementTree.parse(urdf).getroot())
        turns = np.array([chain.axes() for chain in chains])
    except (OSError, ElementTree.ParseError, ValueError, AttributeError, TypeError) as error:
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"{urdf} cannot be imported: {error}") from error
    unlike = (turns[:, :, 2] @ turns[:, :, 2].T).sum(axis=1)
    first = int(unlike.argmin())
    if thumb:
        named = [k for k, chain in enumerate(chains) if chain.joints[0].name.startswith(thumb)]
        if len(named) != 1:
            firsts = ", ".join(chain.joints[0].name for chain in chains)
            raise DgsError(ErrorCode.PARAMETER_INVALID, f"{thumb!r} begins no or several of {firsts}")
        first = named[0]
    chains.insert(0, chains.pop(first))
    base = _base(np.delete(turns, first, axis=0))
    around = base.T @ np.array([c.joints[0].place for c in chains]).T
    order = [0, *(1 + np.argsort(-around[1, 1:]))]
    chains = [chains[k] for k in order]
    names = list(NAMES[: len(chains)])
    file = _file(name, chains, names, base)
    try:
        stance = best_stance(hand_of(file, name))
    except ValueError as error:
        raise DgsError(ErrorCode.PARAMETER_INVALID, f"{urdf} is no hand that grasps: {error}") from error
    put(file, stance)
    return file, _guesses(chains, names, base, stance)


def _chains(root: ElementTree.Element) -> list[_Chain]:
    joints = root.findall("joint")
    children: dict[str, list[ElementTree.Element]] = {}
    for joint in joints:
        children.setdefault(_link(joint, "parent"), []).append(joint)
    tops = set(children) - {_link(joint, "child") for joint in joints}
    if len(tops) != 1:
        raise ValueError(f"it has {len(tops)} root links")
    found: list[_Chain] = []
    _follow(tops.pop(), np.eye(4), (), children, found)
    if not 2 <= len(found) <= 5:
        raise ValueError(f"it has {len(found)} fingers, the suite takes two to five")
    return [_forward(chain) for chain in found]


def _follow(
    link: str,
    pose: Array,
    above: tuple[_Joint, ...],
    children: dict[str, list[ElementTree.Element]],
    found: list[_Chain],
) -> None:
    """Collect the chains that end below `link`, which stands at `pose`; of several leaves the farthest is the tip."""
    before, ends = len(found), []
    for joint in children.get(link, []):
        there, child = pose @ _origin(joint), _link(joint, "child")
        mine = (*above, _joint(joint, there)) if _moves(joint) else above
        if len(mine) > JOINTS_PER_FINGER:
            raise ValueError(f"the finger of {mine[0].name} has more than {JOINTS_PER_FINGER} joints")
        fixed = [] if _moves(joint) else list(_fixed_below(child, there, children))
        if _moves(joint) or any(_moves(lower) for link in fixed for lower in children.get(link[0], [])):
            _follow(child, there, mine, children, found)
        ends += [there[:3, 3], *(place for _, place in fixed)]
    if not above or len(found) > before:
        if above and len(found) > before + 1:
            raise ValueError(f"{above[-1].name} moves a link with several fingers")
        return
    last = above[-1].place
    away = [end for end in ends if np.linalg.norm(end - last) > 1e-3]
    if away:
        found.append(_Chain(above, max(away, key=lambda end: float(np.linalg.norm(end - last))), False))
    else:
        way = last - above[-2].place if len(above) > 1 else pose[:3, 0]
        length = float(np.linalg.norm(way))
        if length < 1e-6:
            unknown = f"nothing says which way the finger of {above[0].name} points"
            raise ValueError(f"{unknown}: add a fixed fingertip frame behind {above[-1].name}")
        found.append(_Chain(above, last + TIP * way / length, True))


def _moves(joint: ElementTree.Element) -> bool:
    kind = joint.get("type", "")
    if kind not in ("revolute", "continuous", "fixed"):
        raise ValueError(f"the joint {joint.get('name')} is {kind}; a finger has revolute and fixed ones")
    return kind != "fixed"


def _fixed_below(
    link: str, pose: Array, children: dict[str, list[ElementTree.Element]]
) -> Iterator[tuple[str, Array]]:
    """Name and place of a link and of all that is fixed to it, whether at once or by way of others."""
    yield link, pose[:3, 3]
    for joint in children.get(link, []):
        if not _moves(joint):
            yield from _fixed_below(_link(joint, "child"), pose @ _origin(joint), children)


def _link(joint: ElementTree.Element, end: str) -> str:
    """Name of the joint's `parent` or `child` link."""
    found = joint.find(end)
    if found is None or "link" not in found.attrib:
        raise ValueError(f"the joint {joint.get('name')} has no {end}")
    return found.attrib["link"]


def _origin(joint: ElementTree.Element) -> Array:
    origin = joint.find("origin")
    if origin is None:
        return np.eye(4)
    xyz, rpy = ([float(v) for v in origin.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
    return from_rpy(xyz, rpy)


def _joint(joint: ElementTree.Element, pose: Array) -> _Joint:
    axis, limit, mimic = joint.find("axis"), joint.find("limit"), joint.find("mimic")
    direction = [1.0, 0.0, 0.0] if axis is None else [float(v) for v in axis.get("xyz", "1 0 0").split()]
    limits = {} if limit is None else limit.attrib
    follows = None if mimic is None else (mimic.get("joint", ""), float(mimic.get("multiplier", 1.0)))
    if mimic is not None and float(mimic.get("offset", 0.0)):
        coupled = f"{joint.get('name')} follows {mimic.get('joint')} with an offset"
        raise ValueError(f"{coupled}, which a hand.yaml cannot say")
    free = limit is None or joint.get("type") == "continuous"
    lower, upper = (-np.pi, np.pi) if free else (float(limits.get(end, 0.0)) for end in ("lower", "upper"))
    length = float(np.linalg.norm(direction))
    if length < 1e-6:
        raise ValueError(f"the joint {joint.get('name')} has an axis of no length")
    turned = pose[:3, :3] @ np.array(direction) / length
    name, effort = joint.get("name", ""), float(limits.get("effort", 0.0))
    return _Joint(name, pose[:3, 3], turned, lower, upper, effort, follows)


def _forward(chain: _Chain) -> _Chain:
    """The finger with joints that bend it by positive angles, whichever way round its maker counts."""
    x = chain.axes()[:, 0]
    joints = tuple(
        replace(joint, axis=-joint.axis, lower=-joint.upper, upper=-joint.lower, sign=-1)
        if abs(joint.axis @ x) > 0.99 and -joint.lower > joint.upper + 1e-6
        else joint
        for joint in chain.joints
    )
    return replace(chain, joints=joints)


def _base(turns: Array) -> Array:
    """(3, 3) axes of `hand_base` in the root: z along the long fingers, x to where they bend."""
    z, x = turns[:, :, 1].mean(axis=0), turns[:, :, 2].mean(axis=0)
    z = z / np.linalg.norm(z)
    x = x - (x @ z) * z
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _file(name: str, chains: list[_Chain], names: list[str], base: Array) -> dict[str, Any]:
    slots = {
        j.name: f"{names[f]}_joint{k + 1}" for f, c in enumerate(chains) for k, j in enumerate(_slots(c)) if j
    }
    led = {joint.name: joint for chain in chains for joint in chain.joints}
    places = base.T @ np.array([chain.joints[0].place for chain in chains]).T
    low, high = places.min(axis=1) - 0.015, places.max(axis=1) + 0.005
    count = len(chains)
    links: dict[str, Any] = {"knuckle": {"mass": 0.01, "centre_of_mass": [0.0, 0.0, 0.0]}}
    for link, radius in zip(LINKS[1:], RADII, strict=True):
        shape = {"radius": radius, "from": 0.0, "to": 0.02, "height": 0.0, "spheres": 3}
        links[link] = {"mass": 0.02, "centre_of_mass": [0.0, 0.01, 0.0], **shape}
    return {
        "name": name,
        "title": name,
        "mount": [0.0, 0.0, 0.0],
        "mount_rpy": rounded(Rotation.from_matrix(base).as_euler("xyz", suppress_warnings=True), 6),
        "tcp": [0.0, 0.0, 0.0],
        "speed": 2.0,
        "damping": 0.05,
        "friction": 0.02,
        "palm": {
            "mass": 0.5,
            "centre_of_mass": _exact((low + high) / 2),
            "boxes": [_exact(np.stack([low, high], axis=1).ravel())],
        },
        "links": links,
        "lengths": [0.0] * JOINTS_PER_FINGER,
        "joints": [{"at": 0.0}] * JOINTS_PER_FINGER,
        "fingers": {n: _finger(c, base, slots, led) for n, c in zip(names, chains, strict=True)},
        "grasp": {
            "widest": 0.08,
            "pre_grasp": [1.0, 0.6, 0.3, 0.3],
            "beyond": [0.0, 0.2, 0.14, 0.14],
            "patterns": [names[: k + 2] for k in range(count - 1)],
            "tip_plane": 0.025,
            "tip_delta": [0.0] * count,
            "circle": [0.0] * count,
            "rectangle": [0.0] * count,
            "thumb_share": 0.8,
            "level_pinch": {
                "fingers": names[:4],
                "thumb_between": names[1:3],
                "thumb_shift": 0.0,
                "lean": 0.0,
            },
            "stiffness": [5.0, 5.0, 2.5, 2.5],
            "thumb_factor": 2.0,
        },
    }


def _slots(chain: _Chain) -> list[_Joint | None]:
    """The four joints; what is missing is missing at the finger's base, but behind a first one that turns it."""
    turns = chain.joints[0].axis @ chain.axes()[:, 0] < 0.99
    lead = int(turns and len(chain.joints) < JOINTS_PER_FINGER)
    missing: list[_Joint | None] = [None] * (JOINTS_PER_FINGER - len(chain.joints))
    return [*chain.joints[:lead], *missing, *chain.joints[lead:]]


def _steps(chain: _Chain) -> list[Array]:
    """The ways from joint to joint and to the tip, in F_i; a missing joint stands where the one before it does."""
    places = [chain.joints[0].place]
    for joint in _slots(chain):
        places.append(places[-1] if joint is None else joint.place)
    turn = chain.axes()
    return [turn.T @ (b - a) for a, b in pairwise([*places[1:], chain.tip])]


def _finger(chain: _Chain, base: Array, slots: dict[str, str], led: dict[str, _Joint]) -> dict[str, Any]:
    turn, steps = chain.axes(), _steps(chain)
    joints: list[dict[str, Any]] = []
    for joint in _slots(chain):
        if joint is None:
            joints.append({"at": 0.0})
        elif joint.upper - joint.lower < 0.01:
            joints.append({"at": round((joint.lower + joint.upper) / 2, 6)})
        else:
            joints.append({"lower": joint.lower, "upper": joint.upper, "effort": joint.effort or 1.0})
            if joint.mimic is not None:
                leader, ratio = _leader(joint, led)
                joints[-1] |= {"follows": slots[leader.name], "ratio": round(ratio, 6)}
    shapes = {}
    for link, step in zip(LINKS[1:], steps[1:], strict=True):
        ball = RADII[2] if link == LINKS[-1] else 0.0
        shapes[link] = {"from": 0.0, "to": round(max(float(step[1]) - ball, 0.005), 6)}
    x = [1.0, 0.0, 0.0]
    return {
        "place": _exact(base.T @ chain.joints[0].place),
        "distal": _exact(base.T @ turn[:, 1]),
        "palmar": _exact(base.T @ turn[:, 2]),
        "lengths": [_exact(step) for step in steps],
        "axes": [x if joint is None else _exact(turn.T @ joint.axis) for joint in _slots(chain)],
        "joints": joints,
        "links": shapes,
    }


def _leader(joint: _Joint, led: dict[str, _Joint]) -> tuple[_Joint, float]:
    """The driven joint that a joint follows in the end, and by which factor."""
    leader, ratio = joint, 1.0
    for _ in led:
        if leader.mimic is None:
            return leader, ratio * leader.sign * joint.sign
        name, factor = leader.mimic
        if name not in led:
            wrong = f"{joint.name} follows {name!r}, which is no joint of a finger"
            raise DgsError(ErrorCode.PARAMETER_INVALID, wrong)
        leader, ratio = led[name], ratio * factor
    raise DgsError(ErrorCode.PARAMETER_INVALID, f"{joint.name} follows itself in the end")


def _guesses(chains: list[_Chain], names: list[str], base: Array, stance: Stance) -> list[str]:
    turned, ahead = np.rad2deg(stance.approach), 1e3 * stance.ahead
    rows = "; ".join(str(_exact(row)) for row in base)
    fingers = list(zip(names, chains, strict=True))
    back = [joint.name for chain in chains for joint in chain.joints if joint.sign < 0]
    bare = [c.joints[0].name for c in chains if np.linalg.norm(_steps(c)[0]) > BARE]
    bare += [
        joint.name
        for chain in chains
        for joint, step in zip(_slots(chain)[1:], _steps(chain)[1:], strict=True)
        if joint is not None and np.hypot(step[0], step[2]) > BARE
    ]
    weak = ", ".join(j.name for c in chains for j in c.joints if not 0.0 < j.effort < 5.0)
    return [
        *(f"{n} is the finger that begins at {c.joints[0].name}" for n, c in fingers),
        f"hand_base is the root turned so that x points out of the palm and z to the fingertips: {rows}",
        f"it approaches {turned:.0f} degrees off the straight fingers' way, to the palm's; tips {ahead:.0f} mm ahead",
        "mount (the root is taken for the flange's face), palm, masses, radii and speed are guesses: measure them; "
        "then find the stance again",
        *([f"counted the other way round than in the URDF: {', '.join(back)}"] if back else []),
        *([f"NO SHAPE stands for the way to the next joint behind {', '.join(bare)}"] if bare else []),
        *(["THE TIPS STAY BEHIND THE PALM: do the fingers bend to the other side?"] if ahead < 0 else []),
        *(f"{n}: no fingertip frame, {TIP * 1e3:.0f} mm taken" for n, c in fingers if c.guessed),
        *([f"torques that are no finger's: {weak}"] if weak else []),
    ]


def main() -> None:
    """Write FOLDER/hand.yaml, which must not be there yet."""
    parser = ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("urdf", type=Path)
    parser.add_argument("folder", type=Path, help="The new hand's folder; its name is the hand's.")
    parser.add_argument("--thumb", default="", help="Begins the name of the thumb's first joint.")
    given = parser.parse_args()
    target = given.folder / FILE
    if target.exists():
        sys.exit(f"{target} is there already; it is not overwritten")
    try:
        file, told = import_hand(given.urdf, given.folder.resolve().name, given.thumb)
    except DgsError as error:
        sys.exit(f"{int(error.code)}: {error.message}")
    try:
        with atomic_write(target, "w") as out:
            yaml.safe_dump(file, out, sort_keys=False, default_flow_style=None, width=110)
    except OSError as error:
        sys.exit(f"{target} cannot be written: {error}")
    print(f"wrote {target}", *told, sep="\n  ")


if __name__ == "__main__":
    main()
