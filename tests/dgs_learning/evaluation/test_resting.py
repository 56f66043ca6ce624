"""How an object lies decides the column of the tables in which it counts."""

from __future__ import annotations

import pytest
from scipy.spatial.transform import Rotation

from dgs_description.frames import transform
from dgs_learning.evaluation.resting import dropped_kinds, resting_kind
from dgs_learning.objects import shapes
from dgs_sim_bridge.render.object_model import ObjectModel, from_parts

BOOK = (0.09, 0.20, 0.02)


def box(size: tuple[float, float, float]) -> ObjectModel:
    return from_parts("box", "cuboid", "box", shapes.box(list(size)), 0.2)


@pytest.mark.parametrize(
    ("size", "turn", "middle", "kind"),
    [
        ((0.05, 0.06, 0.034), (0, 0, 0), 0.017, "low"),
        ((0.05, 0.06, 0.036), (0, 0, 0), 0.018, "fits"),
        ((0.05, 0.06, 0.020), (0, 0, 0), 0.040, "fits"),  # on top of another one
        (BOOK, (0, 0, 0), 0.010, "wide"),
        (BOOK, (90, 0, 0), 0.100, "fits"),  # it stands
        ((0.080, 0.20, 0.05), (0, 0, 61), 0.025, "fits"),  # across, whatever its heading
    ],
)
def test_an_object_is_wide_low_or_fits(
    size: tuple[float, float, float], turn: tuple[float, float, float], middle: float, kind: str
) -> None:
    rotation = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    assert resting_kind(box(size), transform(rotation, (0.1, 0.0, middle))) == kind


def test_dropped_objects_are_counted_by_kind() -> None:
    assert dropped_kinds([box(BOOK), box((0.05, 0.06, 0.07))], 2) == {"fits": 2, "low": 0, "wide": 2}
