"""Writes the bag `table_depth`: depth of five novel objects on the table, as a D455 in the cell would see them.

    python tests/data/record_table.py     # from the repository; replaces the bag

Scene, noise and stamps are seeded, so a second run writes the same images.
"""

from __future__ import annotations

import shutil
from contextlib import closing
from pathlib import Path

import numpy as np

from dgs_perception.bags import BagWriter
from dgs_sim_bridge.render.object_model import find_catalogue
from dgs_sim_bridge.render.d455 import D455, D455Noise
from dgs_sim_bridge.world.world import World, random_scene
from tests.dgs_perception.bags import DEPTH_TOPIC, INFO_TOPIC, START_NS, camera_info, depth_image, write

BAG = Path(__file__).parent / "table_depth"
SEED, OBJECTS, IMAGES, PERIOD_NS = 3, 5, 3, 100_000_000


def main() -> None:
    """Drop the objects, take the pictures, write the bag."""
    if BAG.exists():
        shutil.rmtree(BAG)
    world = World(random_scene(find_catalogue("novel"), OBJECTS, SEED))
    snapshot = world.snapshot()
    world.close()
    rng = np.random.default_rng(SEED)
    with closing(BagWriter(BAG, "mcap", compress=True)) as bag:
        for k in range(IMAGES):
            stamp = START_NS + k * PERIOD_NS
            depth = snapshot.shot(D455Noise(), rng).depth
            write(bag, INFO_TOPIC, camera_info(D455.width, D455.height, D455.fx, stamp), stamp)
            write(bag, DEPTH_TOPIC, depth_image(np.rint(depth * 1000).astype(np.uint16), stamp), stamp)


if __name__ == "__main__":
    main()
