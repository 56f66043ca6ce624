"""Procedural objects: counts of Table I, sound meshes, disjoint catalogues, exact symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dgs_learning.objects import shapes
from dgs_learning.objects.catalogue import (
    NOVEL_COUNTS,
    TRAIN_COUNTS,
    novel_catalogue,
    train_catalogue,
    volume,
)
from dgs_learning.objects.families import NOVEL, TRAIN
from dgs_learning.objects.symmetry import AXIAL_SECTORS, BOX_FAMILIES, TURNS_ABOUT_Z, symmetries
from dgs_sim_bridge.render.object_model import from_parts


@pytest.fixture(scope="module")
def train():
    return train_catalogue()


def test_class_counts_are_those_of_table_one(train):
    found = {c: sum(o.shape_class == c for o in train) for c in TRAIN_COUNTS}
    assert found == {"cuboid": 116, "cylinder": 69, "stick": 72, "sphere": 26, "bowl": 24}
    assert len(train) == 307
    assert sum(NOVEL_COUNTS.values()) >= 60


def test_catalogues_share_no_family():
    train_families = {f for group in TRAIN.values() for f in group}
    novel_families = {f for group in NOVEL.values() for f in group}
    assert not train_families & novel_families


def test_same_seed_same_objects_other_seed_others(train):
    again, other = train_catalogue(), train_catalogue(seed=5)
    assert all(
        np.array_equal(a.vertices, b.vertices) and a.mass == b.mass for a, b in zip(train, again, strict=True)
    )
    assert not np.array_equal(train[0].vertices, other[0].vertices)


def test_objects_have_sane_size_mass_and_outward_meshes(train):
    for model in train + novel_catalogue():
        extent = model.bounds[1] - model.bounds[0]
        assert extent.min() > 0.012 and extent.max() < 0.25, model.name
        assert 0.02 < model.mass < 0.5, model.name
        assert volume(model) > 0, f"{model.name}: faces point inwards"
        assert len({o.name for o in train}) == len(train)


def test_origin_is_the_centre_of_mass():
    parts = shapes.box([0.1, 0.1, 0.1]) + shapes.moved(shapes.box([0.1, 0.1, 0.1]), (0.2, 0, 0))
    model = from_parts("pair", "cuboid", "pair", parts, 1.0)
    assert np.allclose(model.bounds, [[-0.15, -0.05, -0.05], [0.15, 0.05, 0.05]], atol=1e-6)


def test_lathe_keeps_a_convex_profile_whole_and_splits_a_concave_one():
    assert len(shapes.lathe([(0.02, 0), (0.03, 0.01), (0.03, 0.05), (0.02, 0.06)])) == 1
    assert len(shapes.lathe([(0.03, 0), (0.03, 0.05), (0.01, 0.06), (0.01, 0.09)])) == 2


@pytest.mark.parametrize("family", [*sorted(AXIAL_SECTORS), *sorted(BOX_FAMILIES), *sorted(TURNS_ABOUT_Z)])
def test_symmetries_map_the_object_onto_itself(train, family):
    model = next(o for o in train if o.family == family)
    tree = cKDTree(model.vertices)
    for turn in symmetries(family):
        distance, _ = tree.query(model.vertices @ turn.T)
        assert distance.max() < 1.5e-4, "a turned vertex has no partner"
