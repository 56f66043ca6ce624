"""Proposers: from a scene to candidate grasps. What follows does not know who proposed.

A proposer is a callable `(Scene) -> GraspSet`, grasps in the frame *table*, each with a score in [0, 1] and the
proposer's name as its `source`. It states which fingers take part. What the request does not admit is dropped after
it; a proposer of few candidates looks at `scene.request` itself. Where no grasp is left it is asked again, with a lower
`min_score`: what does not depend on that, it makes by `scene.once`.
"""

from __future__ import annotations

from collections.abc import Callable

from dgs_description.grasp import GraspSet
from dgs_grasp_planner.scene import Scene

Proposer = Callable[[Scene], GraspSet]
