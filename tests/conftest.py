"""Fixtures for every test: the nodes' environment, a private ROS domain, a client node."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

import hypothesis
import pytest

from tests.support.environment import REPO_ROOT, reserved_domain_id, ros_environment

if TYPE_CHECKING:
    from tests.support.ros_client import RosClient

FASTDDS_PROFILE = REPO_ROOT / "ros2_ws" / "src" / "dgs_bringup" / "config" / "fastdds.xml"


def pytest_configure(config: pytest.Config) -> None:
    """Keep this process's own DDS traffic on loopback and on the profile that the nodes use.

    A shell starts background jobs with SIGINT ignored, nohup with SIGHUP, and every child would inherit that: the tests
    that send them to a script need them back.
    """
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:
        signal.signal(signal.SIGHUP, lambda *_: None)  # a handler is not inherited
    os.environ.pop("DGS_CELL", None)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(FASTDDS_PROFILE))
    os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    # Several tests run at the same time: threads of one would only take the processor from the others.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    hypothesis.settings.register_profile("dgs", deadline=None)  # a busy machine is no failure
    hypothesis.settings.load_profile("dgs")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long files first: with several processes, a long one at the end would run alone."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    nodes = {item.path for item in items if item.get_closest_marker("integration")}
    items.sort(key=lambda item: (item.path not in slow, item.path not in nodes))


def pytest_report_header(config: pytest.Config) -> str | None:
    """Say so when tests that need ROS are bound to fail."""
    if "dgs_interfaces" in os.environ.get("AMENT_PREFIX_PATH", ""):
        return None
    return "dgs: workspace not sourced, tests that need ROS will fail: `source ros2_ws/setup_env.sh` or `make test`"


@pytest.fixture(scope="session")
def ros_env() -> Mapping[str, str]:
    """Environment variables that `source ros2_ws/setup_env.sh` gives."""
    return ros_environment()


@pytest.fixture
def ros_domain_id() -> Iterator[int]:
    """A ROS_DOMAIN_ID in 1..100 that no other running test uses."""
    with reserved_domain_id() as domain_id:
        yield domain_id


@pytest.fixture
def ros_client(ros_domain_id: int) -> Iterator[RosClient]:
    """A spinning client node in the test's domain."""
    from tests.support.ros_client import RosClient

    with RosClient(ros_domain_id) as client:
        yield client
