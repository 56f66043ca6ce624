"""Checksum of the hand's CAN frames: CRC-8 SAE J1850, which AUTOSAR's end-to-end protection profile 1 uses too."""

from __future__ import annotations

_POLYNOMIAL = 0x1D


def crc8(data: bytes) -> int:
    """CRC-8 with polynomial 0x1D, start value and final xor 0xFF; 0x4B for b"123456789"."""
    value = 0xFF
    for byte in data:
        value = _TABLE[value ^ byte]
    return value ^ 0xFF


def _table() -> bytes:
    table = bytearray()
    for byte in range(256):
        for _ in range(8):
            byte = (byte << 1) ^ (_POLYNOMIAL if byte & 0x80 else 0)
        table.append(byte & 0xFF)
    return bytes(table)


_TABLE = _table()
