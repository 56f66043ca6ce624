"""Curtains, gaps and wandering of images that are drawn by hand."""

import numpy as np
import pytest

from dgs_learning.evaluation.depth_edges import find_edges, summarise

FOCAL = 450.0


def _step(between: int = 0, gap: int = 0) -> np.ndarray:
    """A near half, so many pixels on the way or without depth, and a far half."""
    row = np.r_[np.full(40, 0.8), np.linspace(0.8, 1.2, between + 2)[1:-1], np.zeros(gap), np.full(40, 1.2)]
    return np.tile(row, (30, 1))


@pytest.mark.parametrize("between", [0, 3, 8])
def test_what_lies_between_the_sides_is_counted(between: int) -> None:
    edges = find_edges(_step(between=between), FOCAL)
    assert len(edges.between) == 30 and not edges.gap.any()
    np.testing.assert_allclose(edges.between * FOCAL, between, atol=1.0)
    assert not edges.wander.any()


def test_gaps_are_told_from_curtains() -> None:
    edges = find_edges(_step(gap=4), FOCAL)
    np.testing.assert_allclose(edges.gap * FOCAL, 4)
    assert not edges.between.any() and not len(edges.wander)


def test_the_shadows_side_and_steps_that_are_small_or_slow_do_not_count() -> None:
    assert not len(find_edges(_step()[:, ::-1], FOCAL).gap)
    assert not len(find_edges(np.where(_step() > 1.0, 0.85, 0.8), FOCAL).gap)
    assert not len(find_edges(_step(between=40), FOCAL).gap)


def test_an_edge_that_wanders_is_measured_as_such() -> None:
    depth = _step()
    for v, shift in enumerate(np.random.default_rng(0).integers(-2, 3, len(depth))):
        depth[v] = np.roll(depth[v], shift)
    summary = summarise([find_edges(depth, FOCAL), find_edges(_step(between=3), FOCAL)])
    assert summary["frames"] == 2 and summary["edges"] == 60 and summary["with_gap"] == 0
    assert summary["wander_mrad"] * FOCAL / 1000 == pytest.approx(1.0, abs=0.4)
