"""Everyday families of the fourth catalogue, for training: flat, thin and low things, things with handles and limbs."""

from __future__ import annotations

import numpy as np

from dgs_learning.objects import shapes
from dgs_learning.objects.families import Family, draw
from dgs_learning.objects.shapes import Parts


def blister_pack(rng: np.random.Generator) -> Parts:
    """A thick part on a card."""
    x, y = draw(rng, 0.08, 0.13), draw(rng, 0.11, 0.19)
    a, b, h = draw(rng, 0.4, 0.8) * x, draw(rng, 0.3, 0.6) * y, draw(rng, 0.016, 0.04)
    place = (draw(rng, -0.5, 0.5) * (x - a), draw(rng, -0.5, 0.1) * (y - b), h / 2)
    return shapes.box([x, y, 0.003]) + shapes.moved(shapes.box([a, b, h], 0.003), place)


def board(rng: np.random.Generator) -> Parts:
    """A flat board: a tray, a tile, a tablet."""
    return shapes.box([draw(rng, 0.07, 0.16), draw(rng, 0.1, 0.22), draw(rng, 0.007, 0.02)], 0.001)


def phone(rng: np.random.Generator) -> Parts:
    """A flat thing that spans the hand, with round corners."""
    half = [draw(rng, 0.03, 0.042), draw(rng, 0.055, 0.085), draw(rng, 0.004, 0.009)]
    return shapes.superquadric(half, 0.15, 0.3)


def chips_bag(rng: np.random.Generator) -> Parts:
    """A bag with a belly, flat all around."""
    half = np.array([draw(rng, 0.045, 0.065), draw(rng, 0.06, 0.1), draw(rng, 0.012, 0.025)])
    rim = shapes.box([2 * half[0], 2 * half[1], 0.004], 0.001)
    return shapes.superquadric(half * (0.95, 0.9, 1), 1.0, 0.5) + rim


def lid(rng: np.random.Generator) -> Parts:
    """A lid with a knob."""
    r, h, knob = draw(rng, 0.045, 0.1), draw(rng, 0.008, 0.018), draw(rng, 0.009, 0.014)
    top = draw(rng, 0.02, 0.03)
    disc = shapes.lathe([(r, 0), (r, 0.004), (0.5 * r, h)], sectors=24)
    return disc + shapes.lathe([(0.6 * knob, h), (knob, h + 0.5 * top), (0.8 * knob, h + top)], sectors=12)


def puck(rng: np.random.Generator) -> Parts:
    """A low round box."""
    r, h = draw(rng, 0.022, 0.05), draw(rng, 0.014, 0.03)
    return shapes.lathe([(0.94 * r, 0), (r, 0.003), (r, h - 0.003), (0.94 * r, h)], sectors=20)


def wheel(rng: np.random.Generator) -> Parts:
    """A ring on spokes."""
    r, h, wall = draw(rng, 0.035, 0.06), draw(rng, 0.014, 0.03), draw(rng, 0.008, 0.014)
    ring = shapes.vessel([(r, -h / 2), (r, h / 2)], wall, sectors=18)[1:]
    spoke = shapes.box([2 * r - wall, 0.01, 0.4 * h])
    return ring + [p for k in range(3) for p in shapes.moved(spoke, rpy=(0, 0, k * np.pi / 3))]


def kitchen_knife(rng: np.random.Generator) -> Parts:
    """A blade that stands on its side, and a thick handle."""
    x, y, w, t = draw(rng, 0.09, 0.12), draw(rng, 0.09, 0.15), draw(rng, 0.02, 0.027), draw(rng, 0.011, 0.018)
    blade = [(0, 0, 0, w), (0.6 * y, 0.002, 0, 1.3 * w), (y, 0.3 * w, 0, 0.3 * w)]
    return shapes.box([x, w, t], 0.003) + shapes.moved(shapes.strip(blade, 0.002), (x / 2 - 0.005, 0, 0))


def table_spoon(rng: np.random.Generator) -> Parts:
    """A bent flat handle with a shallow oval end."""
    x, w, rise = draw(rng, 0.11, 0.15), draw(rng, 0.012, 0.022), draw(rng, 0.006, 0.02)
    handle = [(0, 0, 0, w), (0.5 * x, 0, rise, 0.6 * w), (x, 0, 0.002, 0.5 * w)]
    end = shapes.superquadric([draw(rng, 0.022, 0.034), draw(rng, 0.014, 0.024), 0.006], 0.8, 1.0, 7, 12)
    return shapes.strip(handle, 0.004) + shapes.moved(end, (x + 0.018, 0, 0))


def spanner(rng: np.random.Generator) -> Parts:
    """A flat bar with a ring at one end and two jaws at the other."""
    x, w, t = draw(rng, 0.09, 0.16), draw(rng, 0.012, 0.02), draw(rng, 0.006, 0.013)
    ring = shapes.vessel([(w, -t / 2), (w, t / 2)], 0.5 * w, sectors=12)[1:]
    jaw = shapes.strip([(x, 0, 0, w), (x + 0.5 * w, 0.6 * w, 0, w), (x + 1.8 * w, 0.75 * w, 0, 0.6 * w)], t)
    bar = shapes.strip([(0.8 * w, 0, 0, w), (x, 0, 0, 0.9 * w)], t)
    return ring + bar + jaw + [part * (1, -1, 1) for part in jaw]


def scissors(rng: np.random.Generator) -> Parts:
    """Two blades that cross, with a ring at the end of each."""
    r, t, x = draw(rng, 0.016, 0.026), draw(rng, 0.007, 0.012), draw(rng, 0.07, 0.1)
    ring = shapes.vessel([(r, -t / 2), (r, t / 2)], 0.35 * r, sectors=12)[1:]
    arm = shapes.strip([(-0.05, -r, 0, 0.012), (0, 0, 0, 0.016), (x, 0.004, 0, 0.004)], [t, 0.6 * t, 0.4 * t])
    one = shapes.moved(ring, (-0.05 - 0.8 * r, -r, 0)) + arm
    return one + [part * (1, -1, 1) for part in one]


def skimmer(rng: np.random.Generator) -> Parts:
    """A round flat end on a shaft that rises, and a flat handle."""
    r, x, rise = draw(rng, 0.03, 0.05), draw(rng, 0.12, 0.19), draw(rng, 0.02, 0.07)
    w, t = draw(rng, 0.014, 0.026), draw(rng, 0.007, 0.014)
    disc = shapes.lathe([(0.8 * r, 0), (r, draw(rng, 0.003, 0.01))], sectors=18)
    shaft = [(0.9 * r, 0, 0.003, 0.01), (r + 0.4 * x, 0, rise, 0.009)]
    grip = [(r + 0.4 * x, 0, rise, 0.8 * w), (r + 0.9 * x, 0, 1.5 * rise, w), (r + x, 0, 1.6 * rise, 0.8 * w)]
    return disc + shapes.strip(shaft, 0.005) + shapes.strip(grip, t)


def marker(rng: np.random.Generator) -> Parts:
    """A thick pen with a cap."""
    r, h, cap = draw(rng, 0.006, 0.011), draw(rng, 0.1, 0.145), draw(rng, 0.03, 0.05)
    barrel = shapes.lathe([(0.9 * r, 0), (0.9 * r, h)], sectors=12)
    return shapes.moved(barrel + shapes.lathe([(r, 0), (r, cap)], sectors=12), rpy=(0, np.pi / 2, 0))


def clamp(rng: np.random.Generator) -> Parts:
    """A C of flat bars with a spindle."""
    a, b, t = draw(rng, 0.06, 0.1), draw(rng, 0.05, 0.08), draw(rng, 0.012, 0.02)
    back = shapes.moved(shapes.box([t, a, t]), (-b / 2, 0, 0))
    arm = shapes.moved(shapes.box([b, t, t]), (0, a / 2 - t / 2, 0))
    spindle = shapes.tube([(0.4 * b, -0.7 * a, 0), (0.4 * b, 0.2 * a, 0)], 0.005)
    return back + arm + [part * (1, -1, 1) for part in arm] + spindle


def creature(rng: np.random.Generator) -> Parts:
    """A toy: trunk, neck, head, four legs and a tail."""
    x, r = draw(rng, 0.03, 0.05), draw(rng, 0.014, 0.026)
    leg, thick, step = draw(rng, 0.03, 0.06), draw(rng, 0.005, 0.01), draw(rng, -0.01, 0.015)
    up, ahead, tail = draw(rng, 0.0, 0.05), draw(rng, 0.0, 0.02), draw(rng, 0.02, 0.08)
    places = [(s * 0.75 * x, t * 0.7 * r) for s in (-1, 1) for t in (-1, 1)]
    legs = [shapes.tube([(a, b, 0), (a + step, 1.15 * b, -leg)], [1.3 * thick, thick], 8) for a, b in places]
    neck = shapes.tube([(0.8 * x, 0, 0.3 * r), (x + ahead, 0, 0.5 * r + up)], [0.7 * r, 0.5 * r], 8)
    head = shapes.superquadric([draw(rng, 0.014, 0.028), 0.7 * r, 0.7 * r], 1.0, 1.0, 7, 12)
    end = shapes.tube(
        [(-0.8 * x, 0, 0.2 * r), (-x - tail, 0, draw(rng, -0.5, 1.0) * r)], [0.5 * r, 0.2 * r], 8
    )
    trunk = shapes.superquadric([x, r, r], 0.8, 0.9, 7, 12)
    return trunk + neck + shapes.moved(head, (x + ahead + 0.008, 0, 0.6 * r + up)) + end + sum(legs, [])


def figure(rng: np.random.Generator) -> Parts:
    """A toy that stands on two legs, its arms held out."""
    w, h = draw(rng, 0.025, 0.05), draw(rng, 0.035, 0.06)
    leg, t = draw(rng, 0.02, 0.05), draw(rng, 0.016, 0.028)
    trunk = shapes.superquadric([t / 2, w / 2, h / 2], 0.5, 0.6, 7, 12)
    head = shapes.superquadric([0.7 * t, 0.35 * w, draw(rng, 0.012, 0.022)], 1.0, 0.8, 7, 12)
    foot = shapes.moved(shapes.box([1.3 * t, 0.4 * w, leg], 0.002), (0, 0.25 * w, -h / 2 - 0.45 * leg))
    hand = (draw(rng, 0.0, 0.04), 0.5 * w + draw(rng, 0.01, 0.03), draw(rng, -0.02, 0.03))
    arm = shapes.tube([(0, 0.4 * w, 0.3 * h), hand], draw(rng, 0.005, 0.008), 8)
    one = foot + arm
    return trunk + shapes.moved(head, (0, 0, 0.75 * h)) + one + [part * (1, -1, 1) for part in one]


def saucer(rng: np.random.Generator) -> Parts:
    """A small plate with a slanted rim."""
    r, h = draw(rng, 0.05, 0.09), draw(rng, 0.012, 0.024)
    return shapes.vessel([(0.55 * r, 0), (0.8 * r, 0.4 * h), (r, h)], 0.005, sectors=18)


def pan(rng: np.random.Generator) -> Parts:
    """A low pan with a handle."""
    r, h, x = draw(rng, 0.055, 0.1), draw(rng, 0.025, 0.045), draw(rng, 0.08, 0.14)
    w, t, rise = draw(rng, 0.016, 0.026), draw(rng, 0.01, 0.018), draw(rng, 0.0, 0.03)
    handle = shapes.strip([(0.96 * r, 0, 0.8 * h, w), (r + x, 0, 0.8 * h + rise, w)], t)
    return shapes.vessel([(0.85 * r, 0), (r, h)], 0.004, sectors=18) + handle


EVERYDAY: dict[str, tuple[Family, ...]] = {
    "cuboid": (blister_pack, board, phone, chips_bag),
    "cylinder": (lid, puck, wheel),
    "stick": (kitchen_knife, table_spoon, spanner, scissors, skimmer, marker, clamp),
    "sphere": (creature, figure),
    "bowl": (saucer, pan),
}
DENSITY: dict[str, float] = {
    "blister_pack": 400, "board": 700, "phone": 1600, "chips_bag": 350, "lid": 2000, "puck": 900, "wheel": 900,
    "kitchen_knife": 2500, "table_spoon": 4000, "spanner": 5000, "scissors": 3000, "skimmer": 1800, "marker": 900,
    "clamp": 3500, "creature": 500, "figure": 500, "saucer": 2000, "pan": 2500,
}  # fmt: skip
"""Mean density, with what is hollow in them [kg/m^3]."""
