"""The whole suite with its live page in a real browser: a click picks, stop stops, and the docs' pictures.

DGS_DOCS_PICTURES=docs/images python -m pytest tests/integration/test_live_page.py     makes the pictures anew
"""

from __future__ import annotations

import os
import re
import subprocess
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from dgs_interfaces.msg import PickPlan, SimState
from sensor_msgs.msg import JointState

from dgs_description.joints import ARM_JOINTS
from dgs_ros.base_node import LATCHED
from dgs_ros.joint_msgs import positions_of
from dgs_ros.pose_msgs import to_array
from tests.support.browser import Tab, browser
from tests.support.environment import GUARD, REPO_ROOT, reserved_domain_id, ros_environment
from tests.support.live_page import DESK, PHONE, need_browser, patch, pixels, place, printed_address, visit
from tests.support.ros_client import RosClient

pytestmark = [pytest.mark.integration, pytest.mark.slow]
need_browser()

START = REPO_ROOT / "ros2_ws/src/dgs_bringup/scripts/start_suite.sh"
PICTURES = os.environ.get("DGS_DOCS_PICTURES", "")
PARAMETERS = """\
sim_bridge_node:
  ros__parameters: {seed: 0, objects: 5, real_time_factor: 0.5}
viewer_node:
  ros__parameters: {port: 0}
"""
RUN = 300.0
"""Longest run of one pick on a busy machine [s]."""


@dataclass
class Suite:
    """The running suite: a client of its nodes, a visitor of its page, where pictures go."""

    client: RosClient
    tab: Tab
    pictures: Path
    address: str

    def state(self) -> SimState:
        # The first message is the latched one, which may be older than what was done last.
        return self.client.collect(SimState, "/sim/state", 2, qos=LATCHED)[-1]

    def arm(self) -> np.ndarray:
        return positions_of(self.client.collect(JointState, "/joint_states")[0], ARM_JOINTS)

    def save(self, name: str) -> None:
        (self.pictures / name).write_bytes(self.tab.screenshot())


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Suite]:
    folder = tmp_path_factory.mktemp("suite")
    (folder / "params.yaml").write_text(PARAMETERS)
    pictures = REPO_ROOT / PICTURES if PICTURES else folder
    command = ["bash", str(START), "--view", "--params", str(folder / "params.yaml")]
    command += ["--log", str(folder / "logs"), "--timeout", str(GUARD)]
    with reserved_domain_id() as domain, (folder / "out").open("w") as out:
        environment = {**ros_environment(), "ROS_DOMAIN_ID": str(domain)}
        process = subprocess.Popen(
            command, env=environment, cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=out
        )
        try:
            address = printed_address(folder / "out", process)
            with RosClient(domain) as client, browser(folder / "profile") as tab:
                visit(tab, address)
                yield Suite(client, tab, pictures, address)
                assert tab.errors == []
        finally:
            process.terminate()  # the script ends its nodes
            process.wait(60.0)
    for log in (folder / "logs").glob("*.log"):
        assert "Traceback" not in log.read_text(), log.read_text()


def test_cloud_and_robot_are_seen(suite: Suite) -> None:
    def colour_of(name_at: int) -> np.ndarray:
        return patch(pixels(suite.tab), place(to_array(state.poses[name_at].position)))

    state = suite.state()
    shown = [k for k, name in enumerate(state.places) if name == "table"]
    bare = patch(pixels(suite.tab), place((0.45, -0.36, -0.2)))

    def all_seen() -> bool:
        return all(np.abs(colour_of(k) - bare).max() > 25 for k in shown)

    suite.tab.wait(all_seen, "the objects' points, in their colours")
    shoulder = patch(pixels(suite.tab), place((0.0, 0.0, 0.12)))
    assert shoulder.max() > 60, "the robot"
    assert re.search(r"arm \d+ Hz.*cloud \d+ Hz", suite.tab.text())


def test_a_click_on_an_object_picks_that_object(suite: Suite) -> None:
    before = suite.state()
    places = np.array([to_array(pose.position) for pose in before.poses])
    apart = [np.sort(np.linalg.norm(places - here, axis=1))[1] for here in places]
    chosen = int(np.argmax(apart))
    suite.tab.click(*place(places[chosen]))
    suite.tab.wait_for_text("Target: a box", RUN)
    suite.tab.wait(lambda: re.search(r"live\s+(approach|close|lift|carry)", suite.tab.text()), "a pick", RUN)
    (plan,) = suite.client.collect(PickPlan, "/dgs/pick_plan", 1, qos=LATCHED)
    assert plan.chosen >= 0
    for grasp in plan.grasps:
        assert np.linalg.norm(to_array(grasp.reference_point) - places[chosen]) < min(0.12, apart[chosen])
    suite.tab.press("Grasps")
    suite.tab.wait_for_text("chosen")
    suite.save("viewer_1440.png")
    visit(suite.tab, suite.address, PHONE)
    suite.save("viewer_390.png")
    visit(suite.tab, suite.address, DESK)
    suite.tab.press("Time")
    suite.tab.wait_for_text("run ended", RUN)
    after = suite.state()
    others = [k for k in range(len(before.names)) if k != chosen]
    assert [after.places[k] for k in others] == [before.places[k] for k in others]


def test_stop_stops_until_motion_is_allowed_again(suite: Suite) -> None:
    suite.tab.press("Steer")
    suite.tab.press("Whole table")
    suite.tab.press("Clear the table")
    suite.tab.wait(lambda: re.search(r"live\s+transfer", suite.tab.text()), "the arm on its way", RUN)
    places = [suite.tab.place(label) for label in ("Stop", "Time")]
    suite.tab.press("Stop")
    suite.tab.wait_for_text("stopped (211)")
    assert [suite.tab.place(label) for label in ("Stop", "Time")] == places, "no button moves"
    suite.tab.press("Time")
    suite.tab.wait_for_text("no motion until /reset")
    suite.tab.wait_for_text("(504)")
    still = suite.arm()
    time.sleep(2.0)
    np.testing.assert_allclose(suite.arm(), still, atol=1e-3)
    suite.tab.press("Allow motion again")
    suite.tab.wait_for_text("reset:")
    suite.tab.wait(
        lambda: "stopped; call /reset" not in suite.tab.text().partition("Stop")[0], "the end of the stop"
    )
