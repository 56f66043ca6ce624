import time
from unittest.mock import Mock

import can
import pytest

from dgs_description.errors import DgsError, ErrorCode
from dgs_hand_driver.bus import BusSettings, bus_port, open_bus
from tests.support.environment import free_port
from tests.support.refused import refused


def test_nobody_there_is_said_at_once() -> None:
    start = time.monotonic()
    with refused(ErrorCode.HAND_BUS, "simulator"):
        open_bus(BusSettings(port=free_port()))
    assert time.monotonic() - start < 1.0


def test_every_domain_has_a_bus_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert bus_port() == 29536
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    assert (bus_port(), bus_port(4000)) == (29543, 4000)
    with pytest.raises(DgsError, match=":29543"):
        open_bus(BusSettings())


def test_adapter_that_is_not_there() -> None:
    with refused(ErrorCode.HAND_BUS, "socketcan no_such_can"):
        open_bus(BusSettings(interface="socketcan", channel="no_such_can"))


@pytest.mark.parametrize(
    "error",
    [can.CanError("off"), ImportError("no driver"), TypeError("Must specify a serial port."), KeyError(7)],
)
def test_an_adapter_that_cannot_be_used_is_refused(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dgs_hand_driver.bus.can.Bus", Mock(side_effect=error))
    with refused(ErrorCode.HAND_BUS, f"CAN bus kvaser can0 .{error}"):
        open_bus(BusSettings(interface="kvaser"))


def test_unknown_interface_is_refused() -> None:
    with refused(ErrorCode.PARAMETER_INVALID, "socketcan"):
        BusSettings(interface="pigeon")


def test_an_adapter_is_opened_for_fd_frames_where_the_protocol_has_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[dict] = []
    monkeypatch.setattr("dgs_hand_driver.bus.can.Bus", lambda **options: asked.append(options))
    settings = BusSettings(interface="kvaser")
    open_bus(settings)
    open_bus(settings, data_bitrate=5_000_000)
    assert "fd" not in asked[0] and asked[0]["bitrate"] == 1_000_000
    assert asked[1]["fd"] and asked[1]["bitrate"] == 1_000_000 and asked[1]["data_bitrate"] == 5_000_000
