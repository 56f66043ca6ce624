import numpy as np
import pytest
import trimesh

from dgs_description.cell import CELL
from dgs_description.hand import HAND
from dgs_sim_bridge.render.meshes import PALM_ROUNDING, link_meshes, rounded_box

BY_NAME = {mesh.link: mesh for mesh in link_meshes()}


def test_all_meshes_are_closed_and_wound_outwards() -> None:
    for mesh in link_meshes():
        solid = trimesh.Trimesh(*mesh.mesh, process=False)
        assert solid.is_watertight and solid.volume > 0, mesh.link


def test_palm_and_phalanx_have_the_descriptions_extents() -> None:
    palm = BY_NAME["hand_base"].mesh[0]
    np.testing.assert_allclose(palm.min(0), HAND.palm_boxes[:, 0::2].min(0), atol=1e-9)
    np.testing.assert_allclose(palm.max(0), HAND.palm_boxes[:, 1::2].max(0), atol=1e-9)
    capsule, distal = HAND.capsules[0][2], BY_NAME["index_distal"].mesh[0]
    np.testing.assert_allclose(distal[:, 1].max(), capsule.end + capsule.radius, atol=1e-4)
    np.testing.assert_allclose(distal[:, 1].min(), capsule.start - capsule.radius, atol=1e-4)


@pytest.mark.parametrize("thickness", [0.004, 2 * PALM_ROUNDING, 0.05])
def test_a_palm_is_drawn_as_thick_as_it_is(thickness: float) -> None:
    box = np.array([-0.02, 0.03, -0.04, 0.04, 0.0, thickness])
    vertices, _ = rounded_box(box)
    np.testing.assert_allclose(vertices.min(0), box[0::2], atol=1e-9)
    np.testing.assert_allclose(vertices.max(0), box[1::2], atol=1e-9)


def test_table_top_is_at_its_height() -> None:
    assert abs(BY_NAME["table"].mesh[0][:, 2].max() - CELL.table_height) < 1e-9
