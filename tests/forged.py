# SPDX-License-Identifier: Apache-2.0
"""Forged DDS packets, sent straight to the sockets of a process, as no DDS library would send them.

A DATA submessage in the name of a writer that the process knows carries any bytes into its topic.
"""

import contextlib
import os
import socket
import struct
from pathlib import Path

HEADER = b"RTPS\x02\x01\x01\x10"  # version 2.1, vendor Eclipse Cyclone DDS
DATA, HEARTBEAT = 0x15, 0x07
LITTLE_ENDIAN, WITH_PAYLOAD = 0x01, 0x04
ANY_READER = b"\0\0\0\0"
CDR_LE = b"\x00\x01\x00\x00"


def udp_ports(pid):
    """Ports of a process's UDP sockets."""
    inodes, target = set(), ""
    for link in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):  # closed meanwhile
            target = os.readlink(link)
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    ports = set()
    for line in Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]:
        words = line.split()
        if words[9] in inodes:
            ports.add(int(words[1].rpartition(":")[2], 16))
    assert ports, "a node without a socket"
    return sorted(ports)


def send(pid, *packets):
    """Sends packets to every UDP socket of a process."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for port in udp_ports(pid):
            for packet in packets:
                sender.sendto(packet, ("127.0.0.1", port))


def data(gid, number, payload):
    """A packet with one message of a writer.

    Args:
        gid: The 16 bytes that identify the writer.
        number: Its sequence number.
        payload: CDR header and content.
    """
    heartbeat = ANY_READER + gid[12:] + struct.pack("<iIiII", 0, 1, 0, number, number)
    body = struct.pack("<HH", 0, 16) + ANY_READER + gid[12:] + struct.pack("<iI", 0, number)
    body += payload + bytes(-len(payload) % 4)
    flags = LITTLE_ENDIAN | WITH_PAYLOAD
    return (
        HEADER
        + gid[:12]
        + struct.pack("<BBH", HEARTBEAT, LITTLE_ENDIAN | 0x02, len(heartbeat))
        + heartbeat
        + struct.pack("<BBH", DATA, flags, len(body))
        + body
    )
