# SPDX-License-Identifier: Apache-2.0
"""An endpoint of a topic, as `topic info --verbose` shows it."""

from typing import Any

from pneu_graph.bag.qos import INFINITE_NS, OfferedQos


def endpoint_text(endpoint: Any) -> str:
    """Returns the lines for one publisher or subscription.

    Args:
        endpoint: `rclpy.topic_endpoint_info.TopicEndpointInfo`.
    """
    qos = OfferedQos.from_profile(endpoint.qos_profile)
    history = "UNKNOWN" if qos.history == "unknown" else f"{qos.history.upper()} ({qos.depth})"
    return "\n".join(
        [
            f"Node name: {endpoint.node_name}",
            f"Node namespace: {endpoint.node_namespace}",
            f"Topic type: {endpoint.topic_type}",
            f"Topic type hash: {endpoint.topic_type_hash}",
            f"Endpoint type: {endpoint.endpoint_type.name}",
            f"GID: {'.'.join(f'{byte:02x}' for byte in endpoint.endpoint_gid)}",
            "QoS profile:",
            f"  Reliability: {qos.reliability.upper()}",
            f"  History (Depth): {history}",
            f"  Durability: {qos.durability.upper()}",
            f"  Lifespan: {_duration(qos.lifespan_ns)}",
            f"  Deadline: {_duration(qos.deadline_ns)}",
            f"  Liveliness: {qos.liveliness.upper()}",
            f"  Liveliness lease duration: {_duration(qos.lease_ns)}",
        ]
    )


def _duration(value_ns: int) -> str:
    return "Infinite" if value_ns >= INFINITE_NS else f"{value_ns} nanoseconds"
