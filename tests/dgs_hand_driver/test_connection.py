import time
from collections.abc import Iterator

import pytest

from dgs_description.errors import DgsError, ErrorCode
from dgs_hand_driver.connection import BusSettings, HandConnection, open_bus
from dgs_hand_driver.hand import DexHand, HandSettings
from tests.dgs_hand_driver.simulated_hand import SimulatedHand
from tests.dgs_sim_bridge.hand.test_socketcand_server import wait_until
from tests.support.environment import free_port

PORT = free_port()


@pytest.fixture
def connection() -> Iterator[HandConnection]:
    settings = HandSettings(bus_timeout=0.5)
    connection = HandConnection(BusSettings(port=PORT), lambda bus: DexHand(bus, settings), retry_period=0.05)
    yield connection
    connection.close()


def connected(connection: HandConnection) -> bool:
    try:
        connection.hand().state()
        return True
    except DgsError as error:
        assert error.code in (ErrorCode.HAND_BUS, ErrorCode.HAND_SILENT)
        return False


def test_hand_comes_late_goes_and_comes_back(connection: HandConnection) -> None:
    wait_until(lambda: "cannot open" in reason(connection))
    with SimulatedHand(port=PORT):
        wait_until(lambda: connected(connection))
    wait_until(lambda: "cannot open" in reason(connection))
    with SimulatedHand(port=PORT):
        wait_until(lambda: connected(connection))


def reason(connection: HandConnection) -> str:
    try:
        connection.hand()
    except DgsError as error:
        assert error.code == ErrorCode.HAND_BUS
        return error.message
    return ""


def test_nobody_there_is_said_at_once() -> None:
    start = time.monotonic()
    with pytest.raises(DgsError, match="simulator") as caught:
        open_bus(BusSettings(port=free_port()))
    assert caught.value.code == ErrorCode.HAND_BUS
    assert time.monotonic() - start < 1.0


def test_adapter_that_is_not_there() -> None:
    with pytest.raises(DgsError, match="socketcan no_such_can") as caught:
        open_bus(BusSettings(interface="socketcan", channel="no_such_can"))
    assert caught.value.code == ErrorCode.HAND_BUS


def test_unknown_interface_is_refused() -> None:
    with pytest.raises(DgsError, match="socketcan") as caught:
        BusSettings(interface="pigeon")
    assert caught.value.code == ErrorCode.PARAMETER_INVALID
