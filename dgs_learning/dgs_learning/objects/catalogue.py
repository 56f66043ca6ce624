"""The procedural catalogues: 307 training objects in the paper's classes, more to train on; two for tests."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from dgs_description.errors import DgsError, ErrorCode
from dgs_learning.objects import everyday, household
from dgs_learning.objects.everyday import EVERYDAY
from dgs_learning.objects.families import NOVEL, TRAIN, Family
from dgs_learning.objects.household import HOUSEHOLD
from dgs_learning.objects.oversize import OVERSIZE
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts, load_catalogue

TRAIN_COUNTS = {"cuboid": 116, "cylinder": 69, "stick": 72, "sphere": 26, "bowl": 24}
"""Objects per class, Table I of the paper."""
SCALES = (0.8, 0.9, 1.0, 1.1, 1.2)
"""The five scales of every training object (paper, section V)."""

DENSITY = {**household.DENSITY, **everyday.DENSITY}
MASS_RANGE = (0.03, 0.45)
"""Of objects whose family has no density of its own [kg]."""

Catalogue = tuple[dict[str, tuple[Family, ...]], dict[str, int], int]
"""Families and number of objects, both by class, and the seed."""
TRAIN_CATALOGUES: dict[str, Catalogue] = {
    "train": (TRAIN, TRAIN_COUNTS, 0),
    "everyday": (EVERYDAY, {"cuboid": 20, "cylinder": 12, "stick": 28, "sphere": 16, "bowl": 8}, 3),
    "oversize": (OVERSIZE, {"cuboid": 12, "cylinder": 8, "sphere": 6}, 4),
}
"""The paper's 307 objects; other families to train on; what the hand cannot hold."""
TEST_CATALOGUES: dict[str, Catalogue] = {
    "novel": (NOVEL, {"cuboid": 20, "cylinder": 16, "stick": 16, "sphere": 9, "bowl": 9}, 1),
    "household": (HOUSEHOLD, {"cuboid": 18, "cylinder": 12, "stick": 24, "sphere": 4, "bowl": 4}, 2),
}
"""Never trained on; soft household things are rigid here."""
PARTS = ("train", "held_out")


def make_catalogue(name: str, seed: int | None = None) -> list[ObjectModel]:
    """Draw one of `TRAIN_CATALOGUES` or `TEST_CATALOGUES`.

    Args:
        seed: the same seed gives the same objects; object k of a class does not depend on the counts. None = its own.
    """
    families, counts, own = (TRAIN_CATALOGUES | TEST_CATALOGUES)[name]
    objects = []
    for c, (shape_class, count) in enumerate(counts.items()):
        for k in range(count):
            rng = np.random.default_rng([own if seed is None else seed, c, k])
            family = families[shape_class][k % len(families[shape_class])]
            parts = family(rng)
            density = float(np.exp(rng.uniform(np.log(250.0), np.log(700.0))))
            density *= 3.0 if shape_class == "bowl" else 1.0
            model = from_parts(f"{family.__name__}_{k:03d}", shape_class, family.__name__, parts, 1.0)
            mass = float(np.clip(density * volume(model), *MASS_RANGE))
            if family.__name__ in DENSITY:
                mass = DENSITY[family.__name__] * volume(model) * float(rng.uniform(0.85, 1.15))
            objects.append(replace(model, mass=mass))
    return objects


def name_and_scale(scaled: str) -> tuple[str, float]:
    """("bottle_001", 1.1) of "bottle_001@1.10", the name of a scaled object."""
    name, at, scale = scaled.rpartition("@")
    return (name, float(scale)) if at else (scaled, 1.0)


def volume(model: ObjectModel) -> float:
    """Volume of the parts, overlaps counted twice [m^3]."""
    a, b, c = (model.vertices[model.faces[:, k]].astype(np.float64) for k in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


def load_part(where: str) -> list[ObjectModel]:
    """A catalogue file or folder, a part of one (`PATH@train`, `PATH@held_out`), or what `TRAIN_CATALOGUES` names.

    The parts are halves by the SHA-256 of the family, so that all sizes and colours of one product are in the same one
    and new objects do not move the others: a first byte below 128 means training.

    Raises:
        DgsError: as `load_catalogue`; SIM_CATALOGUE: the part is empty.
    """
    if where in TRAIN_CATALOGUES:
        return make_catalogue(where)
    path, _, part = where.rpartition("@")
    if part not in PARTS:
        return load_catalogue(Path(where))
    models = load_catalogue(Path(path))
    own = [m for m in models if (hashlib.sha256(m.family.encode()).digest()[0] < 128) == (part == "train")]
    if not own:
        nothing = f"none of the {len(models)} objects of {path} is in the part {part}; {path} alone is all"
        raise DgsError(ErrorCode.SIM_CATALOGUE, nothing)
    return own
