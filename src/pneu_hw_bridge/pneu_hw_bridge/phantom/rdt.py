# SPDX-License-Identifier: Apache-2.0
"""Packets of ATI's raw data transfer (RDT), by which a Net F/T box streams forces over UDP.

Source: ATI Net F/T manual (9610-05-1022), chapter on UDP: requests of 8 bytes, records of 36,
big-endian.
"""

import struct
from dataclasses import dataclass

PORT = 49152
HEADER = 0x1234
STOP, START = 0, 2
"""Commands: end streaming, begin real-time streaming."""

REQUEST = struct.Struct("!HHI")
RECORD = struct.Struct("!IIIiiiiii")

FAULTS = {
    30: "processor or memory error",
    29: "digital board error",
    28: "analog board error",
    27: "serial link communication error",
    26: "program memory error",
    25: "halted by its configuration",
    24: "settings cannot be validated",
    23: "configuration does not fit the calibration",
    22: "network communication failure",
    21: "CAN communication error",
    20: "RDT communication error",
    19: "EtherNet/IP protocol failure",
    18: "DeviceNet protocol failure",
    17: "transducer saturated, or a converter error",
    14: "watchdog timeout",
    13: "stack check error",
    12: "serial EEPROM failure",
    11: "serial flash failure",
    10: "analog board watchdog timeout",
    9: "too much strain gage excitation current",
    8: "too little strain gage excitation current",
    7: "artificial analog ground out of range",
    6: "analog board supply too high",
    5: "analog board supply too low",
    4: "serial link data unavailable",
    3: "reference voltage or power monitoring error",
    2: "internal temperature error",
    1: "HTTP protocol failure",
}
"""Bits of the status word (manual, system status code); bit 31 says that any is set."""

HARMLESS = 0x8001_0000
"""A monitor condition that the user set is latched; readings are good."""


@dataclass(frozen=True)
class Record:
    """A record.

    Attributes:
        sequence: Of this stream's records, modulo 2^32.
        sample: Of the box's samples, modulo 2^32.
        status: Status word.
        counts: Force x, y, z, torque x, y, z.
    """

    sequence: int
    sample: int
    status: int
    counts: tuple[int, int, int, int, int, int]

    @property
    def fault(self) -> str:
        """What the status word says is wrong; empty where nothing is."""
        wrong = self.status & ~HARMLESS
        if not wrong:
            return ""
        told = [text for bit, text in FAULTS.items() if wrong >> bit & 1]
        return ", ".join(told) or f"status word 0x{self.status:08x}"

    def packed(self) -> bytes:
        """As it is sent."""
        return RECORD.pack(self.sequence, self.sample, self.status, *self.counts)


def unpacked(packet: bytes) -> Record | None:
    """A packet's record; None where it is none.

    Args:
        packet: The packet.
    """
    if len(packet) != RECORD.size:
        return None
    sequence, sample, status, *counts = RECORD.unpack(packet)
    return Record(sequence, sample, status, tuple(counts))


def request(command: int, count: int = 0) -> bytes:
    """A request as it is sent.

    Args:
        command: `START` or `STOP`.
        count: Records that are wanted; 0 for no end.
    """
    return REQUEST.pack(HEADER, command, count)
