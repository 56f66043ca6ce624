"""The physics engines by name. Each is loaded when it is asked for."""

from __future__ import annotations

from collections.abc import Sequence

from dgs_description.frames import Array
from dgs_sim_bridge.render.object_model import ObjectModel
from dgs_sim_bridge.world.hand_world import HandWorld, Wear

ENGINES = ("pybullet", "mujoco")


def open_world(
    engine: str,
    models: Sequence[ObjectModel],
    poses: Sequence[Array],
    table: bool,
    friction: float | None = None,
    wear: Wear | None = None,
    edge: float | None = None,
) -> HandWorld:
    """A world in the engine of this name.

    Args:
        engine: one of `ENGINES`.
        models: the objects.
        poses: (4, 4) each, where they are.
        table: a table top at z = 0, gravity, and the hand carried over it; else the hand is fixed in free space.
        friction: of the hand, the table, on an object with coefficient 1; None = `PHYSICS`'.
        wear: of the hand.
        edge: the table is where x is larger [m]; None = everywhere.

    Raises:
        ValueError: there is no such engine.
    """
    if engine == "pybullet":
        from dgs_sim_bridge.world.bullet_hand import BulletHandWorld

        return BulletHandWorld(models, poses, table, friction, wear, edge)
    if engine == "mujoco":
        from dgs_sim_bridge.world.mujoco_hand import MujocoHandWorld

        return MujocoHandWorld(models, poses, table, friction, wear, edge)
    raise ValueError(f"there is no engine {engine!r}, only {' and '.join(ENGINES)}")
