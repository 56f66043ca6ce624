"""Families of life-like objects: each draws one object's parameters from a random generator.

Families of the training catalogue and of the two test catalogues are disjoint, and so are their parameters.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dgs_learning.objects import shapes
from dgs_learning.objects.shapes import Parts

Family = Callable[[np.random.Generator], Parts]


def draw(rng: np.random.Generator, low: float, high: float) -> float:
    """Uniform in [low, high)."""
    return float(rng.uniform(low, high))


# --- training: cuboids -------------------------------------------------------------------------------------------


def carton(rng: np.random.Generator) -> Parts:
    """A folding box: one graspable edge, the others free."""
    size = np.array([draw(rng, 0.03, 0.07), draw(rng, 0.04, 0.11), draw(rng, 0.06, 0.16)])
    return shapes.box(rng.permutation(size), draw(rng, 0.0, 0.004))


def block(rng: np.random.Generator) -> Parts:
    """A compact block with rounded edges."""
    return shapes.box([draw(rng, 0.035, 0.075) for _ in range(3)], draw(rng, 0.002, 0.012))


def soft_pack(rng: np.random.Generator) -> Parts:
    """A filled bag: a box-like superquadric."""
    half = np.array([draw(rng, 0.018, 0.035), draw(rng, 0.03, 0.055), draw(rng, 0.04, 0.075)])
    return shapes.superquadric(half, draw(rng, 0.3, 0.7), draw(rng, 0.3, 0.8))


def tapered_tub(rng: np.random.Generator) -> Parts:
    """A closed tub that widens towards the top."""
    x, y = draw(rng, 0.035, 0.065), draw(rng, 0.045, 0.09)
    base = np.array([(-x, -y), (x, -y), (x, y), (-x, y)]) / 2
    return shapes.prism(base, draw(rng, 0.05, 0.12), draw(rng, 1.05, 1.25))


def soap(rng: np.random.Generator) -> Parts:
    """A rounded bar of soap: low."""
    half = np.array([draw(rng, 0.022, 0.030), draw(rng, 0.034, 0.048), draw(rng, 0.010, 0.016)])
    return shapes.superquadric(half, draw(rng, 0.4, 0.8), draw(rng, 0.5, 0.9))


def remote(rng: np.random.Generator) -> Parts:
    """A remote control: low, narrow and long."""
    size = [draw(rng, 0.034, 0.046), draw(rng, 0.13, 0.19), draw(rng, 0.019, 0.028)]
    return shapes.box(size, draw(rng, 0.002, 0.005))


# --- training: cylinders -----------------------------------------------------------------------------------------


def can(rng: np.random.Generator) -> Parts:
    """A drink or food can with bevelled rims."""
    r, h, bevel = draw(rng, 0.022, 0.041), draw(rng, 0.05, 0.14), draw(rng, 0.001, 0.006)
    return shapes.lathe([(r - bevel, -h / 2), (r, -h / 2 + bevel), (r, h / 2 - bevel), (r - bevel, h / 2)])


def bottle(rng: np.random.Generator) -> Parts:
    """A bottle with shoulder and neck."""
    r, h = draw(rng, 0.022, 0.039), draw(rng, 0.11, 0.19)
    neck, shoulder = r * draw(rng, 0.35, 0.6), h * draw(rng, 0.55, 0.75)
    middle = shoulder + (h - shoulder) * 0.5
    return shapes.lathe([(r * 0.95, 0), (r, 0.005), (r, shoulder), (neck, middle), (neck, h)])


def jar(rng: np.random.Generator) -> Parts:
    """A jar with a lid of another width."""
    r, h = draw(rng, 0.026, 0.042), draw(rng, 0.05, 0.11)
    lid = r * draw(rng, 0.8, 0.97)
    return shapes.lathe([(r * 0.93, 0), (r, 0.006), (r, h * 0.75), (lid, h * 0.8), (lid, h)])


def paper_cup(rng: np.random.Generator) -> Parts:
    """A closed cup, wider at the top."""
    r, h = draw(rng, 0.022, 0.034), draw(rng, 0.07, 0.13)
    return shapes.lathe([(r, 0), (r * draw(rng, 1.1, 1.35), h)])


# --- training: sticks --------------------------------------------------------------------------------------------


def bar(rng: np.random.Generator) -> Parts:
    """A long bar of rectangular section."""
    size = [draw(rng, 0.018, 0.034), draw(rng, 0.018, 0.036), draw(rng, 0.11, 0.20)]
    return shapes.box(size, draw(rng, 0, 0.004))


def rod(rng: np.random.Generator) -> Parts:
    """A round rod, marker or tube."""
    r, h = draw(rng, 0.009, 0.018), draw(rng, 0.11, 0.20)
    return shapes.lathe([(r * 0.8, 0), (r, 0.004), (r, h - 0.004), (r * 0.8, h)], sectors=14)


def hammer(rng: np.random.Generator) -> Parts:
    """A handle with a cross head."""
    length, r = draw(rng, 0.13, 0.19), draw(rng, 0.009, 0.014)
    head = shapes.box([draw(rng, 0.022, 0.03), draw(rng, 0.06, 0.09), draw(rng, 0.022, 0.032)], 0.003)
    return shapes.lathe([(r, 0), (r * 0.9, length)], sectors=12) + shapes.moved(head, (0, 0, length))


def screwdriver(rng: np.random.Generator) -> Parts:
    """A thick handle and a thin shaft."""
    r, h, length = draw(rng, 0.012, 0.018), draw(rng, 0.08, 0.11), draw(rng, 0.05, 0.10)
    shaft = shapes.moved(shapes.lathe([(0.004, 0), (0.004, length)], sectors=8), (0, 0, h))
    return shapes.lathe([(r * 0.8, 0), (r, 0.01), (r, h * 0.8), (r * 0.7, h)], sectors=12) + shaft


def banana(rng: np.random.Generator) -> Parts:
    """A curved, tapering fruit."""
    bend, radius, r = draw(rng, 1.0, 1.7), draw(rng, 0.07, 0.11), draw(rng, 0.015, 0.020)
    angle = np.linspace(-bend / 2, bend / 2, 7)
    line = np.column_stack([radius * np.cos(angle), np.zeros(7), radius * np.sin(angle)])
    return shapes.tube(line, r * np.array([0.45, 0.85, 1, 1.05, 1, 0.8, 0.35]))


def torch(rng: np.random.Generator) -> Parts:
    """A pocket torch: a tube with a wider head."""
    r, h, head = draw(rng, 0.010, 0.014), draw(rng, 0.09, 0.14), draw(rng, 1.15, 1.7)
    lamp = shapes.moved(shapes.lathe([(r, 0), (r * head, 0.012), (r * head, 0.034)], sectors=14), (0, 0, h))
    return shapes.lathe([(0.8 * r, 0), (r, 0.003), (r, h)], sectors=14) + lamp


def brush(rng: np.random.Generator) -> Parts:
    """A hand brush: a flat block of bristles with a handle."""
    block, grip, t = draw(rng, 0.07, 0.10), draw(rng, 0.08, 0.11), draw(rng, 0.018, 0.024)
    stations = [(0, 0, 0, 0.030), (0.5 * grip, 0, 0, 0.022), (grip, 0, 0, 0.026)]
    head = shapes.moved(
        shapes.box([block, draw(rng, 0.034, 0.044), t + 0.008], 0.003), (grip + block / 2, 0, -0.004)
    )
    return shapes.strip(stations, [t, 0.9 * t, t]) + head


# --- training: spheres -------------------------------------------------------------------------------------------


def ball(rng: np.random.Generator) -> Parts:
    """A ball."""
    return shapes.superquadric([draw(rng, 0.024, 0.040)] * 3, 1.0, 1.0, rings=11, sectors=18)


def apple(rng: np.random.Generator) -> Parts:
    """A fruit, flattened at the poles."""
    r = draw(rng, 0.030, 0.041)
    return shapes.lathe(r * np.array([(0.35, -0.85), (0.85, -0.5), (1, 0), (0.9, 0.45), (0.45, 0.8)]))


def egg(rng: np.random.Generator) -> Parts:
    """An egg or lemon: one axis longer."""
    r = draw(rng, 0.022, 0.034)
    half = [r, r * draw(rng, 0.9, 1.0), r * draw(rng, 1.15, 1.5)]
    return shapes.superquadric(half, draw(rng, 0.9, 1.1), 1.0)


# --- training: bowls ---------------------------------------------------------------------------------------------


def bowl(rng: np.random.Generator) -> Parts:
    """An open bowl."""
    r, h = draw(rng, 0.045, 0.07), draw(rng, 0.035, 0.06)
    return shapes.vessel([(r * 0.45, 0), (r * 0.85, h * 0.45), (r, h)], draw(rng, 0.004, 0.006))


def mug(rng: np.random.Generator) -> Parts:
    """A mug with a handle."""
    r, h = draw(rng, 0.034, 0.042), draw(rng, 0.075, 0.10)
    grip = shapes.moved(shapes.handle(0.024, h * 0.6, r - 0.003, 0.005), (0, 0, h / 2))
    return shapes.vessel([(r * 0.95, 0), (r, h)], draw(rng, 0.004, 0.005)) + grip


def pot(rng: np.random.Generator) -> Parts:
    """A straight pot or planter."""
    r, h = draw(rng, 0.035, 0.05), draw(rng, 0.05, 0.08)
    return shapes.vessel([(r, 0), (r * draw(rng, 1.05, 1.25), h)], draw(rng, 0.004, 0.006))


# --- novel -------------------------------------------------------------------------------------------------------


def milk_carton(rng: np.random.Generator) -> Parts:
    """A box with a gable roof."""
    x, h, roof = draw(rng, 0.045, 0.065), draw(rng, 0.07, 0.11), draw(rng, 0.02, 0.03)
    eaves = [(sx * x / 2, sy * x / 2, 0) for sx in (-1, 1) for sy in (-1, 1)]
    gable = np.array(eaves + [(s * x / 2, 0, roof) for s in (-1, 1)])
    return shapes.box([x, x, h]) + [gable + np.array([0, 0, h / 2])]


def doorstop(rng: np.random.Generator) -> Parts:
    """A blunt wedge."""
    length, low, high = draw(rng, 0.07, 0.12), draw(rng, 0.03, 0.035), draw(rng, 0.045, 0.065)
    outline = np.array([(-length, -low), (length, -high), (length, high), (-length, low)]) / 2
    return shapes.prism(outline, draw(rng, 0.035, 0.06))


def hex_box(rng: np.random.Generator) -> Parts:
    """A gift box of six sides."""
    r, angle = draw(rng, 0.028, 0.042), np.arange(6) * np.pi / 3
    return shapes.prism(r * np.column_stack([np.cos(angle), np.sin(angle)]), draw(rng, 0.04, 0.10))


def angle_block(rng: np.random.Generator) -> Parts:
    """Two bars that form an L."""
    t, a = draw(rng, 0.025, 0.035), draw(rng, 0.07, 0.10)
    b, w = draw(rng, 0.06, 0.09), draw(rng, 0.03, 0.05)
    return shapes.box([a, w, t]) + shapes.moved(shapes.box([t, w, b]), ((a - t) / 2, 0, b / 2))


def flask(rng: np.random.Generator) -> Parts:
    """A waisted bottle."""
    r, h = draw(rng, 0.026, 0.038), draw(rng, 0.11, 0.17)
    waist, neck = r * draw(rng, 0.7, 0.85), [(r * 0.5, h * 0.85), (r * 0.5, h)]
    return shapes.lathe([(r, 0), (r, h * 0.3), (waist, h * 0.5), (r * 0.95, h * 0.7), *neck])


def spool(rng: np.random.Generator) -> Parts:
    """A reel with two flanges."""
    r, h, f = draw(rng, 0.018, 0.028), draw(rng, 0.05, 0.08), draw(rng, 1.25, 1.5)
    rim = r * f
    return shapes.lathe([(rim, 0), (rim, 0.008), (r, 0.01), (r, h - 0.01), (rim, h - 0.008), (rim, h)])


def oval_tin(rng: np.random.Generator) -> Parts:
    """A tin of oval section."""
    r, h = draw(rng, 0.03, 0.045), draw(rng, 0.05, 0.11)
    return shapes.lathe([(r, 0), (r, h)], squash=draw(rng, 0.55, 0.75))


def spoon(rng: np.random.Generator) -> Parts:
    """A handle with an oval end."""
    length, r = draw(rng, 0.11, 0.15), draw(rng, 0.011, 0.014)
    half = [draw(rng, 0.02, 0.028), draw(rng, 0.012, 0.016), draw(rng, 0.028, 0.036)]
    head = shapes.superquadric(half, 1.0, 1.0)
    return shapes.lathe([(r, 0), (r * 0.8, length)], sectors=10) + shapes.moved(head, (0, 0, length + 0.02))


def wrench(rng: np.random.Generator) -> Parts:
    """A flat bar with a wider head at each end."""
    length, w, t = draw(rng, 0.11, 0.16), draw(rng, 0.020, 0.026), draw(rng, 0.022, 0.030)
    head = shapes.box([w * 1.7, t, w * 1.7], 0.004)
    ends = [shapes.moved(head, (0, 0, s * length / 2)) for s in (-1, 1)]
    return sum(ends, shapes.box([w, t, length]))


def elbow_pipe(rng: np.random.Generator) -> Parts:
    """A pipe with a bend."""
    r, a, b = draw(rng, 0.012, 0.017), draw(rng, 0.07, 0.10), draw(rng, 0.05, 0.08)
    line = np.array([(0, 0, 0), (0, 0, a * 0.8), (b * 0.12, 0, a), (b * 0.35, 0, a * 1.06), (b, 0, a * 1.08)])
    return shapes.tube(line, r)


def pear(rng: np.random.Generator) -> Parts:
    """A pear."""
    r = draw(rng, 0.028, 0.037)
    profile = [(0.4, -0.9), (0.9, -0.45), (1, 0), (0.75, 0.6), (0.45, 1.15), (0.3, 1.5)]
    return shapes.lathe(r * np.array(profile))


def die(rng: np.random.Generator) -> Parts:
    """A many-sided die (icosahedron)."""
    phi, r = (1 + 5**0.5) / 2, draw(rng, 0.028, 0.040)
    corners = np.array([(0, s, t * phi) for s in (-1, 1) for t in (-1, 1)])
    points = np.concatenate([np.roll(corners, k, axis=1) for k in range(3)])
    return [points / np.linalg.norm(points[0]) * r]


def onion(rng: np.random.Generator) -> Parts:
    """A bulb with a tip."""
    r = draw(rng, 0.028, 0.038)
    profile = [(0.4, -0.75), (0.9, -0.4), (1, 0), (0.8, 0.5), (0.3, 0.9), (0.15, 1.3)]
    return shapes.lathe(r * np.array(profile))


def ramekin(rng: np.random.Generator) -> Parts:
    """A low straight dish."""
    r, h = draw(rng, 0.036, 0.046), draw(rng, 0.04, 0.055)
    return shapes.vessel([(r * 0.97, 0), (r, h * 0.5), (r, h)], draw(rng, 0.005, 0.007), sectors=16)


def oval_bowl(rng: np.random.Generator) -> Parts:
    """A bowl of oval section."""
    r, h = draw(rng, 0.05, 0.065), draw(rng, 0.04, 0.06)
    return shapes.vessel([(r * 0.6, 0), (r, h)], draw(rng, 0.004, 0.006), squash=draw(rng, 0.65, 0.8))


def tumbler(rng: np.random.Generator) -> Parts:
    """A drinking glass, open at the top."""
    r, h = draw(rng, 0.026, 0.034), draw(rng, 0.08, 0.12)
    return shapes.vessel([(r, 0), (r * draw(rng, 1.1, 1.3), h)], draw(rng, 0.003, 0.004))


TRAIN: dict[str, tuple[Family, ...]] = {
    "cuboid": (carton, block, soft_pack, tapered_tub, soap, remote),
    "cylinder": (can, bottle, jar, paper_cup),
    "stick": (bar, rod, hammer, screwdriver, banana, torch, brush),
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
