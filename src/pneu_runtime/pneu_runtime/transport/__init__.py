# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 graph on the wire, over Cyclone DDS: bytes in and out, services, QoS, discovery.

Names are ROS names, fully qualified. Data are CDR bytes. Nothing here calls back: who waits, with a
`Waiter`, takes what came in its own thread.
"""

from pneu_runtime.transport.endpoints import Publication, Sample, Subscription
from pneu_runtime.transport.errors import (
    EnvironmentVariableError,
    ForeignServiceError,
    TransportError,
    UnknownNodeError,
)
from pneu_runtime.transport.events import EventKind, EventSource
from pneu_runtime.transport.graph import EndpointInfo, Graph
from pneu_runtime.transport.owner import NodeHandle
from pneu_runtime.transport.qos import EndpointQos
from pneu_runtime.transport.services import ClientEnd, RequestId, ServerEnd
from pneu_runtime.transport.session import GraphSource, Session
from pneu_runtime.transport.waiter import Source, Waiter

__all__ = [
    "ClientEnd",
    "EndpointInfo",
    "EndpointQos",
    "EnvironmentVariableError",
    "EventKind",
    "EventSource",
    "ForeignServiceError",
    "Graph",
    "GraphSource",
    "NodeHandle",
    "Publication",
    "RequestId",
    "Sample",
    "ServerEnd",
    "Session",
    "Source",
    "Subscription",
    "TransportError",
    "UnknownNodeError",
    "Waiter",
]
