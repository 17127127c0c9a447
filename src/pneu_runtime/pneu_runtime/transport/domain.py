# SPDX-License-Identifier: Apache-2.0
"""DDS domains of this process: configured from ROS's variables, shared by sessions.

What each discovery range means is taken from ros2/rmw_cyclonedds, branch jazzy, rmw_node.cpp, so
that both find one another. Two things are added: the loopback interface beside the machine's own
one, because processes on one machine have to reach each other also while a cable is unplugged; and
a shorter lease.
"""

import contextlib
import fcntl
import os
import socket
import struct
import threading
from collections.abc import Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

from pneu_runtime.transport import dds
from pneu_runtime.transport.errors import EnvironmentVariableError, TransportError

RANGES = ("LOCALHOST", "SUBNET", "OFF", "SYSTEM_DEFAULT")
HIGHEST_DOMAIN_ID = 232
_HIGHEST_PARTICIPANT_INDEX = 32
_SIOCGIFADDR = 0x8915

# How long the removal of a writer waits for readers that have not confirmed everything; the
# library's own 1 s adds up, one writer after another, when a peer was killed.
# What comes while a process does not run waits in the kernel: as much as a stall of some seconds
# brings, where the machine allows for so much (net.core.rmem_max).
_INTERNAL = (
    "<Internal><WriterLingerDuration>200 ms</WriterLingerDuration>"
    '<SocketReceiveBufferSize min="default" max="8 MB"/></Internal>'
)

# A participant that was killed is given up after so long; the library's own 10 s are long for a
# controller that is started anew, and is one of two until then.
_LEASE = "<LeaseDuration>3 s</LeaseDuration>"


def domain_id_from(environment: Mapping[str, str]) -> int:
    """Returns the domain that `ROS_DOMAIN_ID` asks for, 0 where it is not set.

    Args:
        environment: The variables.

    Raises:
        EnvironmentVariableError: Its value is no domain.
    """
    text = environment.get("ROS_DOMAIN_ID", "") or "0"
    if not text.isascii() or not text.isdigit() or int(text) > HIGHEST_DOMAIN_ID:
        raise EnvironmentVariableError(
            f"ROS_DOMAIN_ID: '{text}' is no domain; allowed are 0 to {HIGHEST_DOMAIN_ID}."
        )
    return int(text)


def configuration(environment: Mapping[str, str]) -> str:
    """Returns the configuration of Cyclone DDS.

    Args:
        environment: The variables `ROS_AUTOMATIC_DISCOVERY_RANGE` (LOCALHOST where it is not set),
            `ROS_STATIC_PEERS` and `CYCLONEDDS_URI` are read.

    Returns:
        str: XML, followed by the user's own, which wins.

    Raises:
        EnvironmentVariableError: A value is not understood.
    """
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "") or "LOCALHOST"
    if reach not in RANGES:
        raise EnvironmentVariableError(
            f"ROS_AUTOMATIC_DISCOVERY_RANGE: '{reach}' is no range; allowed are"
            f" {', '.join(RANGES)}."
        )
    user = environment.get("CYCLONEDDS_URI", "")
    general, discovery = "", ""
    if reach in ("LOCALHOST", "OFF"):
        interfaces = "" if _names_interfaces(user) else _interfaces()
        general = f"<General><AllowMulticast>false</AllowMulticast>{interfaces}</General>"
    peers = [peer.strip() for peer in environment.get("ROS_STATIC_PEERS", "").split(";")]
    peers = [peer for peer in peers if peer] if reach in ("LOCALHOST", "SUBNET") else []
    if reach == "LOCALHOST":
        peers.insert(0, "localhost")
    if peers:
        listed = "".join(f"<Peer address={quoteattr(peer)}/>" for peer in peers)
        discovery = (
            "<ParticipantIndex>auto</ParticipantIndex>"
            f"<MaxAutoParticipantIndex>{_HIGHEST_PARTICIPANT_INDEX}</MaxAutoParticipantIndex>"
            f"<Peers>{listed}</Peers>"
        )
    elif reach == "OFF":
        # participants of different tags do not see each other, whatever a peer list says
        tag = f"ros_discovery_off_{os.getpid()}"
        discovery = f"<Tag>{tag}</Tag>"
    discovery = f"<Discovery>{_LEASE}{discovery}</Discovery>"
    own = f"<CycloneDDS><Domain>{general}{discovery}{_INTERNAL}</Domain></CycloneDDS>"
    return f"{own},{user}" if user else own


def _names_interfaces(uri: str) -> bool:
    """Whether the user's configuration, given as it is or by files, chooses interfaces itself."""
    if "Interface" in uri:
        return True
    for item in uri.split(","):
        name = item.strip().removeprefix("file://")
        if name and not name.startswith("<"):
            # one that cannot be read is Cyclone's to complain of
            with contextlib.suppress(OSError, UnicodeDecodeError):
                if "Interface" in Path(name).read_text(encoding="utf-8"):
                    return True
    return False


def _interfaces() -> str:
    """Loopback and the interface that Cyclone would choose, where there is such a one."""
    if not _has_network_interface():
        return ""
    return (
        '<Interfaces><NetworkInterface autodetermine="true"/>'
        '<NetworkInterface address="127.0.0.1"/></Interfaces>'
    )


def _has_network_interface() -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                answer = fcntl.ioctl(probe.fileno(), _SIOCGIFADDR, request)
            except OSError:  # an interface without an IPv4 address
                continue
            if not socket.inet_ntoa(answer[20:24]).startswith("127."):
                return True
    return False


class _Domains:
    """The domains of this process: the library allows each to be made only once."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[int, tuple[int, int]] = {}

    def acquire(self, domain_id: int, environment: Mapping[str, str]) -> None:
        with self._lock:
            entity, users = self._open.get(domain_id, (0, 0))
            if users == 0:
                text = configuration(environment).encode()
                entity = dds.create_domain(domain_id, text)
                if entity == dds.RETCODE_PRECONDITION_NOT_MET:
                    entity = 0  # made by other code of this process, whose settings then hold
                elif entity < 0:
                    raise TransportError(
                        f"Cyclone DDS refused domain {domain_id} with the configuration"
                        f" {text.decode()}; CYCLONEDDS_URI may hold an error."
                    )
            self._open[domain_id] = (entity, users + 1)

    def release(self, domain_id: int) -> None:
        with self._lock:
            entity, users = self._open[domain_id]
            if users > 1:
                self._open[domain_id] = (entity, users - 1)
                return
            del self._open[domain_id]
            if entity:
                dds.delete(entity)


DOMAINS = _Domains()
