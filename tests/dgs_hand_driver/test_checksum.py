from dgs_hand_driver.checksum import crc8


def test_check_value_of_the_standard() -> None:
    assert crc8(b"123456789") == 0x4B  # SAE J1850, as listed in AUTOSAR's specification of CRC routines


def test_empty_message() -> None:
    assert crc8(b"") == 0x00
