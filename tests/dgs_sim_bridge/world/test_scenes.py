import numpy as np
import pytest

from dgs_description.errors import ErrorCode
from dgs_sim_bridge.render.object_model import find_catalogue, from_parts
from dgs_sim_bridge.world.scenes import PlacedObject, choose_models, drop_scene
from tests.support.refused import refused

CATALOGUE = find_catalogue("novel")


def scene(seed: int, count: int = 5, **options: float) -> list[PlacedObject]:
    rng = np.random.default_rng(seed)
    return drop_scene(choose_models(CATALOGUE, count, rng), rng, **options)  # type: ignore[arg-type]


def test_objects_lie_on_the_table_within_the_area() -> None:
    for seed in range(3):
        for item in scene(seed):
            vertices = item.model.vertices @ item.pose[:3, :3].T + item.pose[:3, 3]
            assert vertices[:, 2].min() == pytest.approx(0, abs=0.003), item.model.name
            assert (np.abs(item.pose[:2, 3]) <= (0.20, 0.40)).all()


def test_objects_keep_clear_of_each_other_where_there_is_room() -> None:
    items = scene(1, 4)
    for k, a in enumerate(items):
        for b in items[k + 1 :]:
            one = a.model.vertices @ a.pose[:3, :3].T + a.pose[:3, 3]
            two = b.model.vertices @ b.pose[:3, :3].T + b.pose[:3, 3]
            gap = np.linalg.norm(one[:, None, :2] - two[None, :, :2], axis=-1).min()
            assert gap > 0.015


def test_same_seed_gives_the_same_scene_bit_by_bit() -> None:
    for one, two in zip(scene(7), scene(7), strict=True):
        assert one.model.name == two.model.name
        np.testing.assert_array_equal(one.pose, two.pose)
    assert any((a.pose != b.pose).any() for a, b in zip(scene(7), scene(8), strict=True))


def test_orientations_vary() -> None:
    up = np.array([item.pose[2, :3] for seed in range(4) for item in scene(seed)])
    assert len(np.unique(np.abs(up).round(1), axis=0)) > 5


def test_crowded_scene_piles_up_and_stays_on_the_table() -> None:
    items = scene(0, 12)
    assert len(items) == 12
    assert max(item.pose[2, 3] for item in items) < 0.3


def test_choice_is_without_repetition_as_long_as_possible() -> None:
    names = [m.name for m in choose_models(CATALOGUE, 30, np.random.default_rng(0))]
    assert len(set(names)) == 30
    few = [m.name for m in choose_models(CATALOGUE[:2], 5, np.random.default_rng(0))]
    assert len(set(few)) == 5
    assert sorted(name.split("#")[0] for name in few[:4]) == sorted(2 * [m.name for m in CATALOGUE[:2]])


@pytest.mark.parametrize("count", [-1, 31])
def test_impossible_counts_are_refused(count: int) -> None:
    with refused(ErrorCode.SIM_REQUEST):
        choose_models(CATALOGUE, count, np.random.default_rng(0))


def test_empty_catalogue_is_refused_but_no_objects_are_fine() -> None:
    with refused(ErrorCode.SIM_CATALOGUE):
        choose_models([], 1, np.random.default_rng(0))
    assert drop_scene([], np.random.default_rng(0)) == []


def test_object_that_does_not_fit_is_refused() -> None:
    plank = np.array([(x, y, z) for x in (0, 0.02) for y in (0, 0.02) for z in (0, 0.02)])
    model = from_parts("cube", "cuboid", "cube", [plank], 0.1)
    with refused(ErrorCode.SIM_SCENE):
        drop_scene([model] * 3, np.random.default_rng(0), area=(0.0, 0.0))
