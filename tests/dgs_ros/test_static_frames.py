"""Fixed frames as a node hears of them: a pose that is none is left out, the others are known."""

from __future__ import annotations

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from dgs_description.frames import BASE_LINK, transform
from dgs_ros.pose_msgs import matrix_to_transform
from dgs_ros.static_frames import TF_STATIC, StaticFrames
from tests.support.environment import reserved_domain_id, wait_until
from tests.support.ros_client import RosClient

pytestmark = pytest.mark.integration


def test_a_pose_that_is_none_is_left_out() -> None:
    heard: list[str] = []
    up = transform(np.eye(3), (0.0, 0.0, 0.5))
    broken = TransformStamped(child_frame_id="broken")
    broken.header.frame_id, broken.transform.rotation.w = BASE_LINK, 0.0
    said = [broken, matrix_to_transform(up, "/mast", "camera"), matrix_to_transform(up, BASE_LINK, "/mast")]
    with reserved_domain_id() as domain, RosClient(domain) as client:
        publisher = client.node.create_publisher(TFMessage, "/tf_static", TF_STATIC)
        publisher.publish(TFMessage(transforms=said))
        frames = StaticFrames(client.node, heard.append)  # hears what was said before
        wait_until(lambda: len(heard) == 2)
    assert heard == ["camera", "mast"]
    np.testing.assert_allclose(frames.pose("camera")[:3, 3], (0, 0, 1.0))
    assert frames.pose("broken") is None
