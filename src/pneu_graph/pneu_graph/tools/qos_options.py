# SPDX-License-Identifier: Apache-2.0
"""QoS that the command line asks for."""

import dataclasses
from typing import Any

from pneu_common.errors import InputError
from pneu_graph.bag.qos import DEFAULT_DEPTH, OfferedQos, adapt_to_publishers

RELIABILITIES = ("reliable", "best_effort")
DURABILITIES = ("volatile", "transient_local")


def _with_options(qos: OfferedQos, reliability: str, durability: str, depth: int) -> OfferedQos:
    for option, value, allowed in (
        ("--qos-reliability", reliability, RELIABILITIES),
        ("--qos-durability", durability, DURABILITIES),
    ):
        if value and value not in allowed:
            raise InputError(f"{option}: is one of {', '.join(allowed)}, found {value!r}")
    if depth < 0:
        raise InputError(f"--qos-depth: is 0 or more, found {depth}")
    return dataclasses.replace(
        qos,
        reliability=reliability or qos.reliability,
        durability=durability or qos.durability,
        depth=depth or qos.depth or DEFAULT_DEPTH,
    )


def chosen_profile(reliability: str, durability: str, depth: int) -> Any:
    """Returns the QoS of a publisher.

    Args:
        reliability: Word of the option; empty: default.
        durability: Word of the option; empty: default.
        depth: Length of the queue; 0: default.

    Raises:
        InputError: A word is unknown.
    """
    return _with_options(OfferedQos(), reliability, durability, depth).profile()


def matching_profile(node: Any, topic: str, reliability: str, durability: str, depth: int) -> Any:
    """Returns a QoS for a subscription that matches the publishers there are.

    Args:
        node: Node that looks.
        topic: The topic.
        reliability: Word of the option; empty: as the publishers.
        durability: Word of the option; empty: as the publishers.
        depth: Length of the queue; 0: default.

    Raises:
        InputError: A word is unknown.
    """
    infos = node.get_publishers_info_by_topic(topic)
    offers = [OfferedQos.from_profile(info.qos_profile) for info in infos]
    base = adapt_to_publishers(offers, DEFAULT_DEPTH) if offers else OfferedQos()
    return _with_options(base, reliability, durability, depth).profile()
