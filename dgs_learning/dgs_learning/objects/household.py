"""Household families of the third catalogue: utensils, tins, tubes, tools, flat and soft things."""

from __future__ import annotations

import numpy as np

from dgs_learning.objects import shapes
from dgs_learning.objects.families import Family, draw
from dgs_learning.objects.shapes import Parts


def game_case(rng: np.random.Generator) -> Parts:
    """A flat plastic case."""
    return shapes.box([draw(rng, 0.105, 0.135), draw(rng, 0.165, 0.19), draw(rng, 0.011, 0.016)], 0.002)


def book(rng: np.random.Generator) -> Parts:
    """Pages between two covers."""
    x, y, h, cover = draw(rng, 0.105, 0.15), draw(rng, 0.165, 0.21), draw(rng, 0.014, 0.032), 0.0025
    board = shapes.box([x, y, cover])
    covers = [p for s in (-1, 1) for p in shapes.moved(board, (0, 0, s * (h - cover) / 2))]
    spine = shapes.moved(shapes.box([cover, y, h]), (-(x - cover) / 2, 0, 0))
    return covers + spine + shapes.moved(shapes.box([x - 0.006, y - 0.01, h - cover]), (-0.003, 0, 0))


def sponge(rng: np.random.Generator) -> Parts:
    """A dish sponge with a scouring pad."""
    x, y, h = draw(rng, 0.085, 0.11), draw(rng, 0.055, 0.07), draw(rng, 0.022, 0.03)
    pad = shapes.box([x - 0.002, y - 0.002, 0.007])
    return shapes.box([x, y, h], 0.005) + shapes.moved(pad, (0, 0, h / 2))


def pouch(rng: np.random.Generator) -> Parts:
    """A filled bag, flat towards its two sealed ends."""
    x, y, h = draw(rng, 0.09, 0.13), draw(rng, 0.075, 0.105), draw(rng, 0.026, 0.04)
    levels = ((1, 1, 0.1), (0.75, 0.96, 0.6), (0.5, 0.9, 0.9), (0.25, 0.7, 1.0))
    belly = np.concatenate([shapes.box(np.array([x, y, h]) * level)[0] for level in levels])
    return [belly, *shapes.box([x + 0.026, y, 0.004])]


def folded_towel(rng: np.random.Generator) -> Parts:
    """Three soft layers, one upon the other."""
    x, y, h = draw(rng, 0.06, 0.1), draw(rng, 0.045, 0.07), draw(rng, 0.008, 0.012)
    layer = shapes.superquadric([x, y, h], 0.5, 0.2, rings=7)
    places = [(*rng.uniform(-0.004, 0.004, 2), k * 1.8 * h) for k in range(3)]
    return [p for place in places for p in shapes.moved(layer, place)]


def tape_measure(rng: np.random.Generator) -> Parts:
    """A case with one flat corner, where the hook looks out."""
    a, width = draw(rng, 0.055, 0.075), draw(rng, 0.028, 0.042)
    angle = np.linspace(0, 1.5 * np.pi, 13)
    case = np.concatenate([np.column_stack([np.cos(angle), np.sin(angle)]), [(1, -1)]]) * a / 2
    hook = shapes.moved(shapes.box([0.004, 0.016, 0.018]), (a / 2 + 0.001, -a / 2 + 0.008, 0))
    return shapes.prism(case, width) + hook


def tuna_tin(rng: np.random.Generator) -> Parts:
    """A low round tin with a rim."""
    r, h, rim = draw(rng, 0.032, 0.044), draw(rng, 0.028, 0.04), 0.0015
    return shapes.lathe([(r, 0), (r, h), (r - rim, h)]) + shapes.lathe([(r + rim, h - 0.003), (r + rim, h)])


def sardine_tin(rng: np.random.Generator) -> Parts:
    """A flat tin with round corners and a rim."""
    half = np.array([draw(rng, 0.048, 0.055), draw(rng, 0.028, 0.038), draw(rng, 0.010, 0.014)])
    rim = shapes.superquadric([half[0] + 0.002, half[1] + 0.002, 0.002], 0.2, 0.35)
    return shapes.superquadric(half, 0.15, 0.35) + shapes.moved(rim, (0, 0, half[2] - 0.002))


def squeeze_tube(rng: np.random.Generator) -> Parts:
    """A tube of paste, round at its cap and flat at its seam."""
    r, length, cap = draw(rng, 0.013, 0.021), draw(rng, 0.09, 0.15), draw(rng, 0.018, 0.026)
    seam = shapes.moved(shapes.box([3.0 * r, 0.003, 0.01]), (0, 0, length))
    body = np.concatenate(shapes.lathe([(r, 0), (r, 0.01)]) + seam)
    top = shapes.lathe([(0.75 * r, -cap), (0.85 * r, 0)])
    return shapes.moved([body, *top], rpy=(np.pi / 2, 0, np.pi / 2))


def tape_roll(rng: np.random.Generator) -> Parts:
    """A roll of adhesive tape: a ring."""
    r, h = draw(rng, 0.036, 0.055), draw(rng, 0.02, 0.048)
    return shapes.vessel([(r, 0), (r, h)], draw(rng, 0.010, 0.016), sectors=18)[1:]


def fork(rng: np.random.Generator) -> Parts:
    """A table fork with four tines."""
    x, w = draw(rng, 0.11, 0.13), draw(rng, 0.017, 0.021)
    handle = [(0, 0, 0, w), (0.4 * x, 0, 0.002, 0.8 * w), (0.75 * x, 0, 0.007, 0.45 * w)]
    head = [(x, 0, 0.009, 0.5 * w), (x + 0.012, 0, 0.004, 0.023), (x + 0.028, 0, 0.001, 0.025)]
    tine = shapes.strip([(0, 0, 0, 0.004), (0.022, 0, 0, 0.0035), (0.04, 0, 0.005, 0.002)], 0.003)
    tines = [p for k in range(4) for p in shapes.moved(tine, (x + 0.028, 0.007 * (k - 1.5), 0.001))]
    return shapes.strip(handle + head, 0.0035) + tines


def table_knife(rng: np.random.Generator) -> Parts:
    """A knife with a thicker handle."""
    grip, blade, w = draw(rng, 0.085, 0.10), draw(rng, 0.10, 0.125), draw(rng, 0.018, 0.023)
    handle = shapes.superquadric([grip / 2, w / 2, draw(rng, 0.005, 0.008)], 0.3, 0.4)
    edge = [(0, 0, 0, 0.6 * w), (0.25 * blade, 0, 0, w), (0.8 * blade, 0, 0, w), (blade, w / 4, 0, w / 3)]
    return handle + shapes.moved(shapes.strip(edge, 0.0025), (grip / 2 - 0.004, 0, 0))


def spatula(rng: np.random.Generator) -> Parts:
    """A turner: a wide thin blade, a shaft that rises from it, and a round handle."""
    w, x = draw(rng, 0.06, 0.08), draw(rng, 0.075, 0.10)
    shaft, r = draw(rng, 0.09, 0.12), draw(rng, 0.009, 0.012)
    flat = shapes.strip([(0, 0, 0, w), (x * 0.8, 0, 0, 0.8 * w), (x, 0, 0.004, 0.02)], 0.003)
    end, rise = x + shaft, 0.004 + 0.35 * shaft
    neck = shapes.strip([(x, 0, 0.004, 0.012), (end, 0, rise, 0.009)], 0.005)
    grip = shapes.lathe([(0.8 * r, 0), (r, 0.012), (r, 0.09), (0.7 * r, 0.105)], sectors=12)
    return flat + neck + shapes.moved(grip, (end - 0.004, 0, rise), (0, np.pi / 2 - 0.35, 0))


def ladle(rng: np.random.Generator) -> Parts:
    """A round scoop with a long handle at its rim."""
    r, x, z = draw(rng, 0.034, 0.044), draw(rng, 0.17, 0.21), draw(rng, 0.03, 0.07)
    scoop = shapes.vessel([(0.4 * r, 0), (0.85 * r, 0.4 * r), (r, 0.8 * r)], 0.004)
    stem, hook = (0.25 * x, 0, 0.4 * z, 0.011), (x + 0.012, 0, z - 0.008, 0.016)
    handle = shapes.strip([(0, 0, 0, 0.014), stem, (x, 0, z, 0.018), hook], 0.005)
    return scoop + shapes.moved(handle, (r - 0.003, 0, 0.8 * r - 0.003))


def pen(rng: np.random.Generator) -> Parts:
    """A ball pen or marker with a clip."""
    r, h = draw(rng, 0.005, 0.011), draw(rng, 0.12, 0.145)
    barrel = shapes.lathe([(0.2 * r, 0), (r, 0.016), (r, h - 0.01), (0.6 * r, h - 0.01), (0.6 * r, h)], 12)
    clip = shapes.moved(shapes.box([0.003, 0.004, 0.038]), (r + 0.002, 0, h - 0.03))
    return shapes.moved(barrel + clip, rpy=(0, np.pi / 2, 0))


def pliers(rng: np.random.Generator) -> Parts:
    """Two arms that cross at a joint."""
    jaw, x = draw(rng, 0.045, 0.06), draw(rng, 0.10, 0.125)
    y, t = draw(rng, 0.018, 0.026), draw(rng, 0.009, 0.013)
    arm = [(jaw, 0.003, 0, 0.005), (0.004, 0.007, 0, 0.014), (-0.012, 0, 0, 0.016)]
    grip = [(-0.012, -0.003, 0, 0.013), (-0.35 * x, -y, 0, 0.013), (-x, -0.9 * y, 0, 0.012)]
    one = shapes.strip(arm, t) + shapes.strip(grip, [t, t + 0.004, t + 0.003])
    joint = shapes.lathe([(0.012, -0.6 * t), (0.012, 0.6 * t)], sectors=12)
    return joint + one + [part * (1, -1, 1) for part in one]


def paint_brush(rng: np.random.Generator) -> Parts:
    """A flat brush: wooden handle, ferrule, bristles."""
    w, x, t = draw(rng, 0.03, 0.06), draw(rng, 0.10, 0.13), draw(rng, 0.012, 0.017)
    handle = [(0, 0, 0, 0.018), (0.3 * x, 0, 0, 0.022), (0.7 * x, 0, 0, 0.015), (x, 0, 0, 0.85 * w)]
    tip = [(x, 0, 0, w), (x + 0.026, 0, 0, w), (x + 0.075, 0, 0, 0.98 * w)]
    return shapes.strip(handle, 0.8 * t) + shapes.strip(tip, [t, t, 0.4 * t])


def plush(rng: np.random.Generator) -> Parts:
    """A sitting plush bear: trunk, head, muzzle; ears, arms, legs (middle and half axes of each [mm])."""
    single = [(0, 0, 45, 33, 36, 45), (4, 0, 108, 34, 38, 33), (36, 0, 100, 14, 16, 13)]
    left = [(0, 30, 138, 8, 14, 14), (20, 40, 58, 28, 13, 14), (45, 27, 16, 36, 17, 16)]
    blobs = np.array(single + left + [(x, -y, *rest) for x, y, *rest in left]) * draw(rng, 0.8, 1.15) / 1e3
    return [p for b in blobs for p in shapes.moved(shapes.superquadric(b[3:], 1, 1, 7, 12), b[:3])]


def plate(rng: np.random.Generator) -> Parts:
    """A plate with a rising rim."""
    r, h = draw(rng, 0.085, 0.125), draw(rng, 0.014, 0.022)
    rim = shapes.vessel([(0.62 * r, 0), (r, h)], 0.14 * r, sectors=24)[1:]
    return shapes.lathe([(0.62 * r, 0), (0.64 * r, 0.005)], sectors=24) + rim


HOUSEHOLD: dict[str, tuple[Family, ...]] = {
    "cuboid": (game_case, book, sponge, pouch, folded_towel, tape_measure),
    "cylinder": (tuna_tin, sardine_tin, squeeze_tube, tape_roll),
    "stick": (fork, table_knife, spatula, ladle, pen, pliers, paint_brush),
    "sphere": (plush,),
    "bowl": (plate,),
}
DENSITY: dict[str, float] = {
    "game_case": 350, "book": 700, "sponge": 80, "pouch": 600, "folded_towel": 250, "tape_measure": 1500,
    "tuna_tin": 1000, "sardine_tin": 1000, "squeeze_tube": 1000, "tape_roll": 900,
    "fork": 5000, "table_knife": 3300, "spatula": 1300, "ladle": 3000, "pen": 900, "pliers": 4500,
    "paint_brush": 900, "plush": 120, "plate": 1900,
}  # fmt: skip
"""Mean density of household things, with what is hollow in them [kg/m^3]."""
