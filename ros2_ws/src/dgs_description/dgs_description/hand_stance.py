"""From which way a hand pinches best, found by trying: what its folder says about approach, TCP and fingertips.

A hand takes things off a table when thumb and fingers meet level with each other and ahead of everything else that it
has. How far ahead they can be depends on the way of the approach: between that of the straight fingers (angle 0) and
that out of the palm (90 degrees). `python -m dgs_description.hand_stance FOLDER` prints it for a hand.
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from dgs_description.errors import DgsError
from dgs_description.frames import Array
from dgs_description.hand_facts import Mask
from dgs_description.hand_file import load_hand
from dgs_description.hand_model import HandModel

POSTURES = 30_000
ANGLES = np.deg2rad(np.arange(0.0, 91.0, 5.0))
WIDTHS = np.array([0.02, 0.04, 0.06])
"""Of the things that are pinched while angles are compared [m]."""
WIDEST = np.arange(0.03, 0.1401, 0.005)
EXACT, LEVEL, ALONG = 0.004, 0.006, 0.85
"""Of a posture that counts: width, difference of depth [m], cosine of pinch and x axis."""
WORTH = 0.004
"""An approach that is farther from the fingers' way has to bring the tips so much farther ahead [m]."""
BEHIND = 0.030
"""The TCP stands so far behind the fingertips [m]."""
NONE = -0.05
"""What counts where no posture pinches a width [m]."""


class Stance(NamedTuple):
    """Fields of `hand.yaml`, and how far the tips are ahead of the rest of the hand (mean over `WIDTHS`) [m]."""

    ahead: float
    approach: float
    tcp: Array
    grasp: dict[str, Any]


def best_stance(hand: HandModel) -> Stance:
    """The way of approach in which thumb and fingers meet farthest ahead of palm and knuckles.

    Args:
        hand: its own approach, TCP and fingertip constraints do not count.

    Raises:
        ValueError: thumb and fingers meet nowhere.
    """
    hand = replace(hand, T_base_tcp=np.eye(4))
    tried = _Postures(hand)
    ahead = [tried.ahead(angle) for angle in ANGLES]
    value = np.array([np.mean([most.max(initial=NONE) for most in each]) for each in ahead])
    chosen = int((value >= value.max() - WORTH).argmax())
    return Stance(float(value[chosen]), float(ANGLES[chosen]), *tried.fields(ANGLES[chosen]))


class _Postures:
    """Postures whose fingers bend alike, drawn at random; coordinates in `hand_base`."""

    def __init__(self, hand: HandModel):
        rng = np.random.default_rng(0)
        low, high = hand.split(hand.lower), hand.split(hand.upper)
        joints = rng.uniform(low, high, (POSTURES, *hand.shape))
        share = rng.uniform(size=(POSTURES, 1, 4))
        alike = low[1:] + share * (high - low)[1:]
        joints[:, 1:] = np.where(
            hand.flexes[1:], alike, np.clip(hand.spread, low[:, 0], high[:, 0])[1:, None]
        )
        joints = hand.split(hand.expand(hand.reduce(joints.reshape(POSTURES, -1))))
        self.hand, self.tips = hand, hand.fingertips(joints)
        balls, spheres = hand.end_balls(joints), hand.finger_spheres(joints)
        self.thumb, self.fingers = balls[:, 0], balls[:, 1:3].mean(axis=1)
        behind = hand.sphere_phalanx < 2
        self.rest = spheres[:, :3, behind].reshape(POSTURES, -1, 3)
        self.radii = np.tile(hand.sphere_radii[behind], min(3, hand.finger_count))
        self.palm = hand.palm_points()

    def _pinching(self, angle: float, width: float) -> tuple[Mask, Array]:
        """Which postures pinch a width so, and (N,) how far their tips are ahead then [m]."""
        side, down = _axes(angle)
        apart = self.thumb - self.fingers
        length = np.linalg.norm(apart, axis=1)
        found = np.abs(length - width - 2 * self.hand.ball_radius) < EXACT
        found &= (np.abs(apart @ down) < LEVEL) & (apart @ side > ALONG * length)
        rows = np.flatnonzero(found)
        tips = np.minimum(self.thumb[rows] @ down, self.fingers[rows] @ down) + self.hand.ball_radius
        rest = (self.rest[rows] @ down + self.radii).max(axis=1)
        return found, tips - np.maximum(rest, (self.palm @ down).max())

    def ahead(self, angle: float) -> list[Array]:
        """Per width of `WIDTHS`, how far the tips of the postures that pinch it are ahead [m]."""
        return [self._pinching(angle, width)[1] for width in WIDTHS]

    def fields(self, angle: float) -> tuple[Array, dict[str, Any]]:
        """TCP in `hand_base`, and what `grasp` says, for an approach."""
        side, down = _axes(angle)
        good = []
        for width in WIDTHS:
            found, ahead = self._pinching(angle, width)
            good.append(np.flatnonzero(found)[ahead >= ahead.max(initial=NONE) - 2 * WORTH])
        rows = np.concatenate(good)
        if not len(rows):
            raise ValueError("thumb and fingers meet nowhere")
        tips = self.tips[rows]
        middle = (self.thumb[rows] + self.fingers[rows]).mean(axis=0) / 2
        middle[1] = tips[:, 1:, 1].mean()
        tcp = middle - BEHIND * down
        y = np.median(tips[..., 1], axis=0) - tcp[1]
        reach = self._reach(tcp, side, down)
        turned = np.arcsin(np.clip(y / 0.035, -0.9, 0.9))
        widest = [w for w in WIDEST if (self._pinching(angle, w)[1] > 0.0).any()]
        return tcp, {
            "widest": round(float(0.85 * max(widest, default=WIDEST[0])), 3),
            "tip_plane": BEHIND + 0.01,
            "tip_delta": rounded((reach - np.median(reach)) / 2),
            "circle": rounded(np.array([turned[0] / 2, *(np.pi - turned[1:])])),
            "rectangle": rounded(y),
        }

    def _reach(self, tcp: Array, side: Array, down: Array) -> Array:
        """(F,) how deep every finger comes 2 cm beside the TCP [m]."""
        across, deep = (self.tips - tcp) @ side, (self.tips - tcp) @ down
        wanted = np.where(np.arange(self.hand.finger_count) == 0, 0.02, -0.02)
        return np.where(np.abs(across - wanted) < EXACT, deep, NONE).max(axis=0)


def _axes(angle: float) -> tuple[Array, Array]:
    """x (from fingers to thumb) and z (ahead) of `hand_tcp` in `hand_base`."""
    return np.array([np.cos(angle), 0.0, -np.sin(angle)]), np.array([np.sin(angle), 0.0, np.cos(angle)])


def rounded(values: Array, digits: int = 4) -> list[float]:
    """Numbers for a file; none is -0."""
    return [round(float(value), digits) + 0.0 for value in values]


def put(file: dict[str, Any], stance: Stance) -> None:
    """Write a stance into the contents of a `hand.yaml`."""
    file["tcp"], file["approach"] = rounded(stance.tcp), round(stance.approach, 4)
    file["grasp"] |= stance.grasp


def main() -> None:
    """Print what belongs into FOLDER/hand.yaml."""
    parser = ArgumentParser(description="Print what a hand's folder says about approach, TCP and fingertips.")
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    try:
        found = best_stance(load_hand(folder.resolve()))
    except DgsError as error:
        sys.exit(f"{int(error.code)}: {error.message}")
    except ValueError as error:
        sys.exit(f"{folder}: {error}")
    print(f"# tips {1e3 * found.ahead:.0f} mm ahead of palm and knuckles")
    told: dict[str, Any] = {"grasp": {}}
    put(told, found)
    print(yaml.safe_dump(told, sort_keys=False, default_flow_style=None), end="")


if __name__ == "__main__":
    main()
