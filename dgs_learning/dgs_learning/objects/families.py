"""Families of life-like objects: each draws one object's parameters from a random generator.

Families of the training catalogue and of the two test catalogues are disjoint, and so are their parameters.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dgs_learning.objects import shapes
from dgs_learning.objects.shapes import Parts

Family = Callable[[np.random.Generator], Parts]


def _u(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


# --- training: cuboids -------------------------------------------------------------------------------------------


def carton(rng: np.random.Generator) -> Parts:
    """A folding box: one graspable edge, the others free."""
    size = np.array([_u(rng, 0.03, 0.07), _u(rng, 0.04, 0.11), _u(rng, 0.06, 0.16)])
    return shapes.box(rng.permutation(size), _u(rng, 0.0, 0.004))


def block(rng: np.random.Generator) -> Parts:
    """A compact block with rounded edges."""
    return shapes.box([_u(rng, 0.035, 0.075) for _ in range(3)], _u(rng, 0.002, 0.012))


def soft_pack(rng: np.random.Generator) -> Parts:
    """A filled bag: a box-like superquadric."""
    half = np.array([_u(rng, 0.018, 0.035), _u(rng, 0.03, 0.055), _u(rng, 0.04, 0.075)])
    return shapes.superquadric(half, _u(rng, 0.3, 0.7), _u(rng, 0.3, 0.8))


def tapered_tub(rng: np.random.Generator) -> Parts:
    """A closed tub that widens towards the top."""
    x, y = _u(rng, 0.035, 0.065), _u(rng, 0.045, 0.09)
    return shapes.prism(
        np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / 2, _u(rng, 0.05, 0.12), _u(rng, 1.05, 1.25)
    )


# --- training: cylinders -----------------------------------------------------------------------------------------


def can(rng: np.random.Generator) -> Parts:
    """A drink or food can with bevelled rims."""
    r, h, bevel = _u(rng, 0.022, 0.041), _u(rng, 0.05, 0.14), _u(rng, 0.001, 0.006)
    return shapes.lathe([(r - bevel, -h / 2), (r, -h / 2 + bevel), (r, h / 2 - bevel), (r - bevel, h / 2)])


def bottle(rng: np.random.Generator) -> Parts:
    """A bottle with shoulder and neck."""
    r, h = _u(rng, 0.022, 0.039), _u(rng, 0.11, 0.19)
    neck, shoulder = r * _u(rng, 0.35, 0.6), h * _u(rng, 0.55, 0.75)
    return shapes.lathe(
        [(r * 0.95, 0), (r, 0.005), (r, shoulder), (neck, shoulder + (h - shoulder) * 0.5), (neck, h)]
    )


def jar(rng: np.random.Generator) -> Parts:
    """A jar with a lid of another width."""
    r, h = _u(rng, 0.026, 0.042), _u(rng, 0.05, 0.11)
    lid = r * _u(rng, 0.8, 0.97)
    return shapes.lathe([(r * 0.93, 0), (r, 0.006), (r, h * 0.75), (lid, h * 0.8), (lid, h)])


def paper_cup(rng: np.random.Generator) -> Parts:
    """A closed cup, wider at the top."""
    r, h = _u(rng, 0.022, 0.034), _u(rng, 0.07, 0.13)
    return shapes.lathe([(r, 0), (r * _u(rng, 1.1, 1.35), h)])


# --- training: sticks --------------------------------------------------------------------------------------------


def bar(rng: np.random.Generator) -> Parts:
    """A long bar of rectangular section."""
    return shapes.box([_u(rng, 0.018, 0.034), _u(rng, 0.018, 0.036), _u(rng, 0.11, 0.20)], _u(rng, 0, 0.004))


def rod(rng: np.random.Generator) -> Parts:
    """A round rod, marker or tube."""
    r, h = _u(rng, 0.009, 0.018), _u(rng, 0.11, 0.20)
    return shapes.lathe([(r * 0.8, 0), (r, 0.004), (r, h - 0.004), (r * 0.8, h)], sectors=14)


def hammer(rng: np.random.Generator) -> Parts:
    """A handle with a cross head."""
    length, r = _u(rng, 0.13, 0.19), _u(rng, 0.009, 0.014)
    head = shapes.box([_u(rng, 0.022, 0.03), _u(rng, 0.06, 0.09), _u(rng, 0.022, 0.032)], 0.003)
    return shapes.lathe([(r, 0), (r * 0.9, length)], sectors=12) + shapes.moved(head, (0, 0, length))


def screwdriver(rng: np.random.Generator) -> Parts:
    """A thick handle and a thin shaft."""
    r, h, shaft = _u(rng, 0.012, 0.018), _u(rng, 0.08, 0.11), _u(rng, 0.05, 0.10)
    return shapes.lathe([(r * 0.8, 0), (r, 0.01), (r, h * 0.8), (r * 0.7, h)], sectors=12) + shapes.moved(
        shapes.lathe([(0.004, 0), (0.004, shaft)], sectors=8), (0, 0, h)
    )


def banana(rng: np.random.Generator) -> Parts:
    """A curved, tapering fruit."""
    bend, radius, r = _u(rng, 1.0, 1.7), _u(rng, 0.07, 0.11), _u(rng, 0.015, 0.020)
    angle = np.linspace(-bend / 2, bend / 2, 7)
    line = np.column_stack([radius * np.cos(angle), np.zeros(7), radius * np.sin(angle)])
    return shapes.tube(line, r * np.array([0.45, 0.85, 1, 1.05, 1, 0.8, 0.35]))


# --- training: spheres -------------------------------------------------------------------------------------------


def ball(rng: np.random.Generator) -> Parts:
    """A ball."""
    return shapes.superquadric([_u(rng, 0.024, 0.040)] * 3, 1.0, 1.0, rings=11, sectors=18)


def apple(rng: np.random.Generator) -> Parts:
    """A fruit, flattened at the poles."""
    r = _u(rng, 0.030, 0.041)
    return shapes.lathe(
        [(r * 0.35, -r * 0.85), (r * 0.85, -r * 0.5), (r, 0.0), (r * 0.9, r * 0.45), (r * 0.45, r * 0.8)]
    )


def egg(rng: np.random.Generator) -> Parts:
    """An egg or lemon: one axis longer."""
    r = _u(rng, 0.022, 0.034)
    return shapes.superquadric([r, r * _u(rng, 0.9, 1.0), r * _u(rng, 1.15, 1.5)], _u(rng, 0.9, 1.1), 1.0)


# --- training: bowls ---------------------------------------------------------------------------------------------


def bowl(rng: np.random.Generator) -> Parts:
    """An open bowl."""
    r, h = _u(rng, 0.045, 0.07), _u(rng, 0.035, 0.06)
    return shapes.vessel([(r * 0.45, 0), (r * 0.85, h * 0.45), (r, h)], _u(rng, 0.004, 0.006))


def mug(rng: np.random.Generator) -> Parts:
    """A mug with a handle."""
    r, h = _u(rng, 0.034, 0.042), _u(rng, 0.075, 0.10)
    grip = shapes.moved(shapes.handle(0.024, h * 0.6, r - 0.003, 0.005), (0, 0, h / 2))
    return shapes.vessel([(r * 0.95, 0), (r, h)], _u(rng, 0.004, 0.005)) + grip


def pot(rng: np.random.Generator) -> Parts:
    """A straight pot or planter."""
    r, h = _u(rng, 0.035, 0.05), _u(rng, 0.05, 0.08)
    return shapes.vessel([(r, 0), (r * _u(rng, 1.05, 1.25), h)], _u(rng, 0.004, 0.006))


# --- novel -------------------------------------------------------------------------------------------------------


def milk_carton(rng: np.random.Generator) -> Parts:
    """A box with a gable roof."""
    x, h, roof = _u(rng, 0.045, 0.065), _u(rng, 0.07, 0.11), _u(rng, 0.02, 0.03)
    gable = np.array(
        [(sx * x / 2, sy * x / 2, 0) for sx in (-1, 1) for sy in (-1, 1)]
        + [(s * x / 2, 0, roof) for s in (-1, 1)]
    )
    return shapes.box([x, x, h]) + [gable + np.array([0, 0, h / 2])]


def doorstop(rng: np.random.Generator) -> Parts:
    """A blunt wedge."""
    length, low, high = _u(rng, 0.07, 0.12), _u(rng, 0.03, 0.035), _u(rng, 0.045, 0.065)
    outline = [
        (-length / 2, -low / 2),
        (length / 2, -high / 2),
        (length / 2, high / 2),
        (-length / 2, low / 2),
    ]
    return shapes.prism(outline, _u(rng, 0.035, 0.06))


def hex_box(rng: np.random.Generator) -> Parts:
    """A gift box of six sides."""
    r, angle = _u(rng, 0.028, 0.042), np.arange(6) * np.pi / 3
    return shapes.prism(r * np.column_stack([np.cos(angle), np.sin(angle)]), _u(rng, 0.04, 0.10))


def angle_block(rng: np.random.Generator) -> Parts:
    """Two bars that form an L."""
    t, a, b, w = _u(rng, 0.025, 0.035), _u(rng, 0.07, 0.10), _u(rng, 0.06, 0.09), _u(rng, 0.03, 0.05)
    return shapes.box([a, w, t]) + shapes.moved(shapes.box([t, w, b]), ((a - t) / 2, 0, b / 2))


def flask(rng: np.random.Generator) -> Parts:
    """A waisted bottle."""
    r, h = _u(rng, 0.026, 0.038), _u(rng, 0.11, 0.17)
    waist = r * _u(rng, 0.7, 0.85)
    return shapes.lathe(
        [(r, 0), (r, h * 0.3), (waist, h * 0.5), (r * 0.95, h * 0.7), (r * 0.5, h * 0.85), (r * 0.5, h)]
    )


def spool(rng: np.random.Generator) -> Parts:
    """A reel with two flanges."""
    r, h, f = _u(rng, 0.018, 0.028), _u(rng, 0.05, 0.08), _u(rng, 1.25, 1.5)
    return shapes.lathe(
        [(r * f, 0), (r * f, 0.008), (r, 0.01), (r, h - 0.01), (r * f, h - 0.008), (r * f, h)]
    )


def oval_tin(rng: np.random.Generator) -> Parts:
    """A tin of oval section."""
    r, h = _u(rng, 0.03, 0.045), _u(rng, 0.05, 0.11)
    return shapes.lathe([(r, 0), (r, h)], squash=_u(rng, 0.55, 0.75))


def spoon(rng: np.random.Generator) -> Parts:
    """A handle with an oval end."""
    length, r = _u(rng, 0.11, 0.15), _u(rng, 0.011, 0.014)
    head = shapes.superquadric([_u(rng, 0.02, 0.028), _u(rng, 0.012, 0.016), _u(rng, 0.028, 0.036)], 1.0, 1.0)
    return shapes.lathe([(r, 0), (r * 0.8, length)], sectors=10) + shapes.moved(head, (0, 0, length + 0.02))


def wrench(rng: np.random.Generator) -> Parts:
    """A flat bar with a wider head at each end."""
    length, w, t = _u(rng, 0.11, 0.16), _u(rng, 0.020, 0.026), _u(rng, 0.022, 0.030)
    head = shapes.box([w * 1.7, t, w * 1.7], 0.004)
    return shapes.box([w, t, length]) + [
        p for s in (-1, 1) for p in shapes.moved(head, (0, 0, s * length / 2))
    ]


def elbow_pipe(rng: np.random.Generator) -> Parts:
    """A pipe with a bend."""
    r, a, b = _u(rng, 0.012, 0.017), _u(rng, 0.07, 0.10), _u(rng, 0.05, 0.08)
    line = np.array([(0, 0, 0), (0, 0, a * 0.8), (b * 0.12, 0, a), (b * 0.35, 0, a * 1.06), (b, 0, a * 1.08)])
    return shapes.tube(line, r)


def pear(rng: np.random.Generator) -> Parts:
    """A pear."""
    r = _u(rng, 0.028, 0.037)
    return shapes.lathe(
        [
            (r * 0.4, -r * 0.9),
            (r * 0.9, -r * 0.45),
            (r, 0),
            (r * 0.75, r * 0.6),
            (r * 0.45, r * 1.15),
            (r * 0.3, r * 1.5),
        ]
    )


def die(rng: np.random.Generator) -> Parts:
    """A many-sided die (icosahedron)."""
    phi, r = (1 + 5**0.5) / 2, _u(rng, 0.028, 0.040)
    corners = np.array([(0, s, t * phi) for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    return [points / np.linalg.norm(points[0]) * r]


def onion(rng: np.random.Generator) -> Parts:
    """A bulb with a tip."""
    r = _u(rng, 0.028, 0.038)
    return shapes.lathe(
        [
            (r * 0.4, -r * 0.75),
            (r * 0.9, -r * 0.4),
            (r, 0),
            (r * 0.8, r * 0.5),
            (r * 0.3, r * 0.9),
            (r * 0.15, r * 1.3),
        ]
    )


def ramekin(rng: np.random.Generator) -> Parts:
    """A low straight dish."""
    r, h = _u(rng, 0.036, 0.046), _u(rng, 0.04, 0.055)
    return shapes.vessel([(r * 0.97, 0), (r, h * 0.5), (r, h)], _u(rng, 0.005, 0.007), sectors=16)


def oval_bowl(rng: np.random.Generator) -> Parts:
    """A bowl of oval section."""
    r, h = _u(rng, 0.05, 0.065), _u(rng, 0.04, 0.06)
    return shapes.vessel([(r * 0.6, 0), (r, h)], _u(rng, 0.004, 0.006), squash=_u(rng, 0.65, 0.8))


def tumbler(rng: np.random.Generator) -> Parts:
    """A drinking glass, open at the top."""
    r, h = _u(rng, 0.026, 0.034), _u(rng, 0.08, 0.12)
    return shapes.vessel([(r, 0), (r * _u(rng, 1.1, 1.3), h)], _u(rng, 0.003, 0.004))


# --- household, as they lie on a table ---------------------------------------------------------------------------


def game_case(rng: np.random.Generator) -> Parts:
    """A flat plastic case."""
    return shapes.box([_u(rng, 0.105, 0.135), _u(rng, 0.165, 0.19), _u(rng, 0.011, 0.016)], 0.002)


def book(rng: np.random.Generator) -> Parts:
    """Pages between two covers."""
    x, y, h, cover = _u(rng, 0.105, 0.15), _u(rng, 0.165, 0.21), _u(rng, 0.014, 0.032), 0.0025
    board = shapes.box([x, y, cover])
    covers = [p for s in (-1, 1) for p in shapes.moved(board, (0, 0, s * (h - cover) / 2))]
    spine = shapes.moved(shapes.box([cover, y, h]), (-(x - cover) / 2, 0, 0))
    return covers + spine + shapes.moved(shapes.box([x - 0.006, y - 0.01, h - cover]), (-0.003, 0, 0))


def sponge(rng: np.random.Generator) -> Parts:
    """A dish sponge with a scouring pad."""
    x, y, h = _u(rng, 0.085, 0.11), _u(rng, 0.055, 0.07), _u(rng, 0.022, 0.03)
    pad = shapes.box([x - 0.002, y - 0.002, 0.007])
    return shapes.box([x, y, h], 0.005) + shapes.moved(pad, (0, 0, h / 2))


def pouch(rng: np.random.Generator) -> Parts:
    """A filled bag, flat towards its two sealed ends."""
    x, y, h = _u(rng, 0.09, 0.13), _u(rng, 0.075, 0.105), _u(rng, 0.026, 0.04)
    levels = ((1, 1, 0.1), (0.75, 0.96, 0.6), (0.5, 0.9, 0.9), (0.25, 0.7, 1.0))
    belly = np.concatenate([shapes.box(np.array([x, y, h]) * level)[0] for level in levels])
    return [belly, *shapes.box([x + 0.026, y, 0.004])]


def folded_towel(rng: np.random.Generator) -> Parts:
    """Three soft layers, one upon the other."""
    x, y, h = _u(rng, 0.06, 0.1), _u(rng, 0.045, 0.07), _u(rng, 0.008, 0.012)
    layer = shapes.superquadric([x, y, h], 0.5, 0.2, rings=7)
    places = [(*rng.uniform(-0.004, 0.004, 2), k * 1.8 * h) for k in range(3)]
    return [p for place in places for p in shapes.moved(layer, place)]


def tape_measure(rng: np.random.Generator) -> Parts:
    """A case with one flat corner, where the hook looks out."""
    a, width = _u(rng, 0.055, 0.075), _u(rng, 0.028, 0.042)
    angle = np.linspace(0, 1.5 * np.pi, 13)
    case = np.concatenate([np.column_stack([np.cos(angle), np.sin(angle)]), [(1, -1)]]) * a / 2
    hook = shapes.moved(shapes.box([0.004, 0.016, 0.018]), (a / 2 + 0.001, -a / 2 + 0.008, 0))
    return shapes.prism(case, width) + hook


def tuna_tin(rng: np.random.Generator) -> Parts:
    """A low round tin with a rim."""
    r, h, rim = _u(rng, 0.032, 0.044), _u(rng, 0.028, 0.04), 0.0015
    return shapes.lathe([(r, 0), (r, h), (r - rim, h)]) + shapes.lathe([(r + rim, h - 0.003), (r + rim, h)])


def sardine_tin(rng: np.random.Generator) -> Parts:
    """A flat tin with round corners and a rim."""
    half = np.array([_u(rng, 0.048, 0.055), _u(rng, 0.028, 0.038), _u(rng, 0.010, 0.014)])
    rim = shapes.superquadric([half[0] + 0.002, half[1] + 0.002, 0.002], 0.2, 0.35)
    return shapes.superquadric(half, 0.15, 0.35) + shapes.moved(rim, (0, 0, half[2] - 0.002))


def squeeze_tube(rng: np.random.Generator) -> Parts:
    """A tube of paste, round at its cap and flat at its seam."""
    r, length, cap = _u(rng, 0.013, 0.021), _u(rng, 0.09, 0.15), _u(rng, 0.018, 0.026)
    seam = shapes.moved(shapes.box([3.0 * r, 0.003, 0.01]), (0, 0, length))
    body = np.concatenate(shapes.lathe([(r, 0), (r, 0.01)]) + seam)
    top = shapes.lathe([(0.75 * r, -cap), (0.85 * r, 0)])
    return shapes.moved([body, *top], rpy=(np.pi / 2, 0, np.pi / 2))


def tape_roll(rng: np.random.Generator) -> Parts:
    """A roll of adhesive tape: a ring."""
    r, h = _u(rng, 0.036, 0.055), _u(rng, 0.02, 0.048)
    return shapes.vessel([(r, 0), (r, h)], _u(rng, 0.010, 0.016), sectors=18)[1:]


def fork(rng: np.random.Generator) -> Parts:
    """A table fork with four tines."""
    x, w = _u(rng, 0.11, 0.13), _u(rng, 0.017, 0.021)
    handle = [(0, 0, 0, w), (0.4 * x, 0, 0.002, 0.8 * w), (0.75 * x, 0, 0.007, 0.45 * w)]
    head = [(x, 0, 0.009, 0.5 * w), (x + 0.012, 0, 0.004, 0.023), (x + 0.028, 0, 0.001, 0.025)]
    tine = shapes.strip([(0, 0, 0, 0.004), (0.022, 0, 0, 0.0035), (0.04, 0, 0.005, 0.002)], 0.003)
    tines = [p for k in range(4) for p in shapes.moved(tine, (x + 0.028, 0.007 * (k - 1.5), 0.001))]
    return shapes.strip(handle + head, 0.0035) + tines


def table_knife(rng: np.random.Generator) -> Parts:
    """A knife with a thicker handle."""
    grip, blade, w = _u(rng, 0.085, 0.10), _u(rng, 0.10, 0.125), _u(rng, 0.018, 0.023)
    handle = shapes.superquadric([grip / 2, w / 2, _u(rng, 0.005, 0.008)], 0.3, 0.4)
    edge = [(0, 0, 0, 0.6 * w), (0.25 * blade, 0, 0, w), (0.8 * blade, 0, 0, w), (blade, w / 4, 0, w / 3)]
    return handle + shapes.moved(shapes.strip(edge, 0.0025), (grip / 2 - 0.004, 0, 0))


def spatula(rng: np.random.Generator) -> Parts:
    """A turner: a wide thin blade, a shaft that rises from it, and a round handle."""
    w, x, shaft, r = _u(rng, 0.06, 0.08), _u(rng, 0.075, 0.10), _u(rng, 0.09, 0.12), _u(rng, 0.009, 0.012)
    flat = shapes.strip([(0, 0, 0, w), (x * 0.8, 0, 0, 0.8 * w), (x, 0, 0.004, 0.02)], 0.003)
    end, rise = x + shaft, 0.004 + 0.35 * shaft
    neck = shapes.strip([(x, 0, 0.004, 0.012), (end, 0, rise, 0.009)], 0.005)
    grip = shapes.lathe([(0.8 * r, 0), (r, 0.012), (r, 0.09), (0.7 * r, 0.105)], sectors=12)
    return flat + neck + shapes.moved(grip, (end - 0.004, 0, rise), (0, np.pi / 2 - 0.35, 0))


def ladle(rng: np.random.Generator) -> Parts:
    """A round scoop with a long handle at its rim."""
    r, x, z = _u(rng, 0.034, 0.044), _u(rng, 0.17, 0.21), _u(rng, 0.03, 0.07)
    scoop = shapes.vessel([(0.4 * r, 0), (0.85 * r, 0.4 * r), (r, 0.8 * r)], 0.004)
    stem = [
        (0, 0, 0, 0.014),
        (0.25 * x, 0, 0.4 * z, 0.011),
        (x, 0, z, 0.018),
        (x + 0.012, 0, z - 0.008, 0.016),
    ]
    return scoop + shapes.moved(shapes.strip(stem, 0.005), (r - 0.003, 0, 0.8 * r - 0.003))


def pen(rng: np.random.Generator) -> Parts:
    """A ball pen or marker with a clip."""
    r, h = _u(rng, 0.005, 0.011), _u(rng, 0.12, 0.145)
    barrel = shapes.lathe([(0.2 * r, 0), (r, 0.016), (r, h - 0.01), (0.6 * r, h - 0.01), (0.6 * r, h)], 12)
    clip = shapes.moved(shapes.box([0.003, 0.004, 0.038]), (r + 0.002, 0, h - 0.03))
    return shapes.moved(barrel + clip, rpy=(0, np.pi / 2, 0))


def pliers(rng: np.random.Generator) -> Parts:
    """Two arms that cross at a joint."""
    jaw, x, y, t = _u(rng, 0.045, 0.06), _u(rng, 0.10, 0.125), _u(rng, 0.018, 0.026), _u(rng, 0.009, 0.013)
    arm = [(jaw, 0.003, 0, 0.005), (0.004, 0.007, 0, 0.014), (-0.012, 0, 0, 0.016)]
    grip = [(-0.012, -0.003, 0, 0.013), (-0.35 * x, -y, 0, 0.013), (-x, -0.9 * y, 0, 0.012)]
    one = shapes.strip(arm, t) + shapes.strip(grip, [t, t + 0.004, t + 0.003])
    joint = shapes.lathe([(0.012, -0.6 * t), (0.012, 0.6 * t)], sectors=12)
    return joint + one + [part * (1, -1, 1) for part in one]


def paint_brush(rng: np.random.Generator) -> Parts:
    """A flat brush: wooden handle, ferrule, bristles."""
    w, x, t = _u(rng, 0.03, 0.06), _u(rng, 0.10, 0.13), _u(rng, 0.012, 0.017)
    handle = [(0, 0, 0, 0.018), (0.3 * x, 0, 0, 0.022), (0.7 * x, 0, 0, 0.015), (x, 0, 0, 0.85 * w)]
    tip = [(x, 0, 0, w), (x + 0.026, 0, 0, w), (x + 0.075, 0, 0, 0.98 * w)]
    return shapes.strip(handle, 0.8 * t) + shapes.strip(tip, [t, t, 0.4 * t])


def plush(rng: np.random.Generator) -> Parts:
    """A sitting plush bear: trunk, head, muzzle; ears, arms, legs (middle and half axes of each [mm])."""
    single = [(0, 0, 45, 33, 36, 45), (4, 0, 108, 34, 38, 33), (36, 0, 100, 14, 16, 13)]
    left = [(0, 30, 138, 8, 14, 14), (20, 40, 58, 28, 13, 14), (45, 27, 16, 36, 17, 16)]
    blobs = np.array(single + left + [(x, -y, *rest) for x, y, *rest in left]) * _u(rng, 0.8, 1.15) / 1e3
    return [p for b in blobs for p in shapes.moved(shapes.superquadric(b[3:], 1, 1, 7, 12), b[:3])]


def plate(rng: np.random.Generator) -> Parts:
    """A plate with a rising rim."""
    r, h = _u(rng, 0.085, 0.125), _u(rng, 0.014, 0.022)
    rim = shapes.vessel([(0.62 * r, 0), (r, h)], 0.14 * r, sectors=24)[1:]
    return shapes.lathe([(0.62 * r, 0), (0.64 * r, 0.005)], sectors=24) + rim


TRAIN: dict[str, tuple[Family, ...]] = {
    "cuboid": (carton, block, soft_pack, tapered_tub),
    "cylinder": (can, bottle, jar, paper_cup),
    "stick": (bar, rod, hammer, screwdriver, banana),
    "sphere": (ball, apple, egg),
    "bowl": (bowl, mug, pot),
}
NOVEL: dict[str, tuple[Family, ...]] = {
    "cuboid": (milk_carton, doorstop, hex_box, angle_block),
    "cylinder": (flask, spool, oval_tin),
    "stick": (spoon, wrench, elbow_pipe),
    "sphere": (pear, die, onion),
    "bowl": (ramekin, oval_bowl, tumbler),
}
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
