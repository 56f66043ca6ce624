"""The page's picture with another hand than that of this process."""

from __future__ import annotations

from tests.support.hands import in_process_of

ROBOT = """
import viser
from dgs_viewer.scene import Scene
from dgs_viewer.state import Sample
scene = Scene(viser.ViserServer(host="127.0.0.1", port=0, verbose=False))
scene.show_robot(Sample())
print("drawn")
"""


def test_a_hand_of_four_fingers_is_drawn() -> None:
    assert "drawn" in in_process_of("allegro", ROBOT)
