"""Procedural objects: counts of Table I, sound meshes, disjoint catalogues, exact symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from dgs_description.errors import ErrorCode
from dgs_learning.evaluation.resting import dropped_kinds
from dgs_learning.objects import shapes
from dgs_learning.objects.catalogue import (
    DENSITY,
    PARTS,
    TEST_CATALOGUES,
    TRAIN_CATALOGUES,
    TRAIN_COUNTS,
    load_part,
    make_catalogue,
    name_and_scale,
    volume,
)
from dgs_learning.objects.everyday import EVERYDAY
from dgs_learning.objects.families import NOVEL, TRAIN
from dgs_learning.objects.household import HOUSEHOLD
from dgs_learning.objects.symmetry import (
    BOX_FAMILIES,
    TURNS_ABOUT_Z,
    symmetries,
    symmetries_of,
)
from dgs_learning.synthesis.scenes import STILL, drop_pose
from dgs_sim_bridge.render.object_model import find_catalogue, from_parts, save_catalogue
from dgs_sim_bridge.world.scenes import SettlingTable
from tests.support.refused import refused


def test_a_scaled_object_is_named_after_its_own_whatever_that_is() -> None:
    model = from_parts("cup@home", "bowl", "cup", [[(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]], 0.1)
    assert name_and_scale(model.scaled(1.1).name) == ("cup@home", 1.1)
    assert name_and_scale("bottle_001") == ("bottle_001", 1.0)


@pytest.fixture(scope="module")
def train():
    return make_catalogue("train")


def test_class_counts_are_those_of_table_one(train):
    found = {c: sum(o.shape_class == c for o in train) for c in TRAIN_COUNTS}
    assert found == {"cuboid": 116, "cylinder": 69, "stick": 72, "sphere": 26, "bowl": 24}
    assert len(train) == 307
    assert sum(TEST_CATALOGUES["novel"][1].values()) >= 60


def test_catalogues_share_no_family():
    tables = (TRAIN, EVERYDAY, NOVEL, HOUSEHOLD)
    families = [f.__name__ for table in tables for group in table.values() for f in group]
    assert len(families) == len(set(families))
    dense = {f.__name__ for table in (EVERYDAY, HOUSEHOLD) for group in table.values() for f in group}
    assert dense == set(DENSITY)


def test_same_seed_same_objects_other_seed_others(train):
    again, other = make_catalogue("train"), make_catalogue("train", seed=5)
    assert all(
        np.array_equal(a.vertices, b.vertices) and a.mass == b.mass for a, b in zip(train, again, strict=True)
    )
    assert not np.array_equal(train[0].vertices, other[0].vertices)


def test_objects_have_sane_size_mass_and_outward_meshes(train):
    for model in train + make_catalogue("novel"):
        extent = model.bounds[1] - model.bounds[0]
        assert extent.min() > 0.012 and extent.max() < 0.25, model.name
        assert 0.02 < model.mass < 0.5, model.name
        assert volume(model) > 0, f"{model.name}: faces point inwards"
        assert len({o.name for o in train}) == len(train)


@pytest.mark.parametrize("catalogue", ["household", "everyday", "oversize"])
def test_things_of_use_have_the_size_and_mass_of_their_kind(catalogue):
    limits = {  # largest extent [m], mass [kg]
        "fork": (0.17, 0.21, 0.03, 0.07), "pen": (0.11, 0.16, 0.005, 0.03), "plate": (0.16, 0.26, 0.25, 0.6),
        "book": (0.16, 0.22, 0.15, 0.8), "pliers": (0.14, 0.20, 0.15, 0.35), "plush": (0.10, 0.18, 0.03, 0.1),
        "sponge": (0.08, 0.12, 0.008, 0.03), "tuna_tin": (0.06, 0.095, 0.08, 0.35),
        "phone": (0.11, 0.18, 0.1, 0.3), "table_spoon": (0.13, 0.21, 0.03, 0.12), "spanner": (0.1, 0.2, 0.03, 0.3),
        "creature": (0.09, 0.2, 0.02, 0.15), "pan": (0.18, 0.35, 0.15, 0.6), "puck": (0.04, 0.11, 0.01, 0.25),
    }  # fmt: skip
    objects = make_catalogue(catalogue)
    counts = (TRAIN_CATALOGUES | TEST_CATALOGUES)[catalogue][1]
    assert len(objects) == sum(counts.values()) == len({o.name for o in objects})
    for model in objects:
        extent = model.bounds[1] - model.bounds[0]
        low, high, light, heavy = limits.get(model.family, (0.05, 0.32, 0.005, 0.8))
        assert low < extent.max() < high and light < model.mass < heavy, (model.name, extent, model.mass)
        assert volume(model) > 0 and min(len(part) for part in model.parts) >= 8, model.name


def test_the_shipped_files_are_what_the_families_draw():
    for name in TEST_CATALOGUES:
        for shipped, drawn in zip(find_catalogue(name), make_catalogue(name), strict=True):
            assert shipped.name == drawn.name and shipped.mass == pytest.approx(drawn.mass)
            assert np.allclose(shipped.vertices, drawn.vertices, atol=1e-6), shipped.name


@pytest.mark.parametrize("catalogue", ["household", "everyday"])
def test_things_of_use_come_to_rest_on_the_table(catalogue):
    for k, model in enumerate({o.family: o for o in make_catalogue(catalogue)}.values()):
        for drop in range(3):
            with SettlingTable() as table:
                table.add(model, drop_pose(np.random.default_rng([3, k, drop]), model, (0.6, 0.6)))
                table.step(960)
                (pose,) = table.poses()
                assert table.still(*STILL).all(), f"{model.name} is not at rest after 4 s"
            lowest = (model.vertices @ pose[:3, :3].T)[:, 2].min() + pose[2, 3]
            assert abs(lowest) < 0.002, f"{model.name} lies {1e3 * lowest:.1f} mm above the table"


def test_oversize_things_are_broader_than_the_hand_opens_in_every_direction():
    directions = np.random.default_rng(0).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for model in make_catalogue("oversize"):
        along = model.vertices @ directions.T
        assert (along.max(0) - along.min(0)).min() > 0.095, model.name


def test_flat_things_lie_low_and_wide_ones_wide():
    objects = {o.family: o for o in make_catalogue("household") + make_catalogue("everyday")}
    lie = {"fork": "low", "pen": "low", "plate": "wide", "game_case": "wide", "spanner": "low", "lid": "wide"}
    for family, kind in lie.items():
        kinds = dropped_kinds([objects[family]], 3)
        assert kinds[kind] == kinds.total() > 0, (family, kinds)


@pytest.mark.parametrize("name", sorted(TRAIN_CATALOGUES))
def test_training_catalogues_are_found_by_name(name):
    assert [m.name for m in load_part(name)] == [m.name for m in make_catalogue(name)]


def test_an_empty_part_is_refused(tmp_path):
    save_catalogue(tmp_path / "one.npz", make_catalogue("novel")[:1])
    with refused(ErrorCode.SIM_CATALOGUE, "none of the 1 objects of .* is in the part"):
        [load_part(f"{tmp_path / 'one.npz'}@{part}") for part in PARTS]


def test_origin_is_the_centre_of_mass():
    parts = shapes.box([0.1, 0.1, 0.1]) + shapes.moved(shapes.box([0.1, 0.1, 0.1]), (0.2, 0, 0))
    model = from_parts("pair", "cuboid", "pair", parts, 1.0)
    assert np.allclose(model.bounds, [[-0.15, -0.05, -0.05], [0.15, 0.05, 0.05]], atol=1e-6)


def test_lathe_keeps_a_convex_profile_whole_and_splits_a_concave_one():
    assert len(shapes.lathe([(0.02, 0), (0.03, 0.01), (0.03, 0.05), (0.02, 0.06)])) == 1
    assert len(shapes.lathe([(0.03, 0), (0.03, 0.05), (0.01, 0.06), (0.01, 0.09)])) == 2


@pytest.mark.parametrize("family", sorted({*BOX_FAMILIES, *TURNS_ABOUT_Z}))
def test_symmetries_map_the_object_onto_itself(train, family):
    model = next(o for o in train if o.family == family)
    tree = cKDTree(model.vertices)
    for turn in symmetries(family):
        distance, _ = tree.query(model.vertices @ turn.T)
        assert distance.max() < 1.5e-4, "a turned vertex has no partner"
    assert len(symmetries_of(model)) == len(symmetries(family))
