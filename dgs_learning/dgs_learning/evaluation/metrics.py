"""Success and clearance rates with Wilson intervals, per class and pooled, and why attempts failed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from dgs_learning.evaluation.protocol import NO_GRASP, SceneResult
from dgs_learning.evaluation.scene_world import Outcome
from dgs_sim_bridge.object_model import SHAPE_CLASSES


def wilson(successes: int, trials: int, z: float = 1.96) -> tuple[float, float]:
    """Wilson score interval of a proportion (Wilson, 1927); (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    p = successes / trials
    centre = (p + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z / (1 + z * z / trials) * np.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    return float(max(0.0, centre - half)), float(min(1.0, centre + half))


def summarise(results: Sequence[SceneResult]) -> dict[str, Any]:
    """SR, CR and failure counts of finished scenes; rates in [0, 1], times in seconds."""
    attempts = [a for r in results for a in r.attempts]
    tried = [a for a in attempts if a.outcome != NO_GRASP]
    won = [a for a in tried if a.outcome == Outcome.SUCCESS.value]
    objects, cleared = sum(r.objects for r in results), sum(r.cleared for r in results)
    per_class = {}
    for name in SHAPE_CLASSES:
        own = [a for a in tried if a.shape_class == name]
        good = sum(a.outcome == Outcome.SUCCESS.value for a in own)
        per_class[name] = {"attempts": len(own), "sr": good / max(1, len(own)), "sr_interval": wilson(good, len(own))}
    return {
        "scenes": len(results),
        "objects": objects,
        "attempts": len(tried),
        "successes": len(won),
        "sr": len(won) / max(1, len(tried)),
        "sr_interval": wilson(len(won), len(tried)),
        "cr_pooled": cleared / max(1, objects),
        "cr_interval": wilson(cleared, objects),
        "cr_scene_mean": float(np.mean([r.cleared / max(1, r.objects) for r in results])) if results else 0.0,
        "per_class": per_class,
        "failures": dict(Counter(a.outcome for a in attempts if a.outcome != Outcome.SUCCESS.value)),
        "time_s": float(np.median([a.seconds for a in attempts])) if attempts else 0.0,
    }
