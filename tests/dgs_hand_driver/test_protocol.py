from dataclasses import replace

import pytest

from dgs_description.errors import ErrorCode
from dgs_description.hand import HAND
from dgs_description.hand_file import load_hand
from dgs_hand_driver.dbc_codec import DbcCodec
from dgs_hand_driver.dbc_protocol import DbcProtocol
from dgs_hand_driver.protocol import protocol_class
from tests.support.refused import refused


def test_the_folder_names_the_protocol() -> None:
    assert protocol_class() is DbcProtocol
    assert protocol_class(load_hand("dexhand_021")).__name__ == "DexHand021"


@pytest.mark.parametrize(
    ("protocol", "complaint"),
    [
        ("", "no protocol of the hand dexhand_pro is known"),
        ("no_such_module:Hand", "cannot be loaded"),
        ("dgs_hand_driver.dbc_protocol:NoSuchClass", "cannot be loaded"),
        ("dgs_hand_driver.dbc_protocol:DbcFirmware", "is no HandProtocol"),
        ("dgs_hand_driver.dbc_protocol:MAX_STEP", "is no HandProtocol"),
    ],
)
def test_what_cannot_be_spoken_is_refused(protocol: str, complaint: str) -> None:
    with refused(ErrorCode.HAND_PROTOCOL, complaint):
        protocol_class(replace(HAND, protocol=protocol))


def test_the_dbc_has_no_place_for_a_fourth_motor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dgs_hand_driver.dbc_codec.HAND", load_hand("allegro"))
    with refused(ErrorCode.HAND_PROTOCOL, "fourth motor of a finger, which allegro has"):
        DbcCodec()
