# SPDX-License-Identifier: Apache-2.0
"""QoS profiles as rosbag2 writes them into bags: text to profile and back.

Since Iron the policies are words; Humble and older wrote the integers of the middleware. Both are
read, words are written.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any

from pneu_common.documents import parse_yaml
from pneu_common.errors import InputError

INFINITE_NS = 2**63 - 1
"""How rmw writes a duration without limit, ns."""

_WORDS = {
    "history": ("system_default", "keep_last", "keep_all", "unknown"),
    "reliability": ("system_default", "reliable", "best_effort", "unknown", "best_available"),
    "durability": ("system_default", "transient_local", "volatile", "unknown", "best_available"),
    "liveliness": (
        "system_default",
        "automatic",
        "manual_by_node",
        "manual_by_topic",
        "unknown",
        "best_available",
    ),
}
DEFAULT_DEPTH = 10


@dataclasses.dataclass(frozen=True)
class OfferedQos:
    """QoS that one publisher offered.

    Attributes:
        history: keep_last, keep_all, system_default or unknown.
        depth: Length of the history; 0 where it is not known.
        reliability: reliable, best_effort, and the words of `history` for the undetermined.
        durability: volatile, transient_local, likewise.
        deadline_ns: Longest time between messages, ns.
        lifespan_ns: Time after which a message is stale, ns.
        liveliness: automatic, manual_by_topic, likewise.
        lease_ns: Lease of the liveliness, ns.
        avoid_ros_namespace_conventions: Whether the topic has no ROS prefix on the wire.
    """

    history: str = "keep_last"
    depth: int = DEFAULT_DEPTH
    reliability: str = "reliable"
    durability: str = "volatile"
    deadline_ns: int = INFINITE_NS
    lifespan_ns: int = INFINITE_NS
    liveliness: str = "automatic"
    lease_ns: int = INFINITE_NS
    avoid_ros_namespace_conventions: bool = False

    @classmethod
    def from_profile(cls, profile: Any) -> "OfferedQos":
        """Takes over a profile of rclpy.

        Args:
            profile: `rclpy.qos.QoSProfile`, such as the graph reports for an endpoint.
        """

        def word(policy: str) -> str:
            value = int(getattr(profile, policy))
            return _WORDS[policy][value] if value < len(_WORDS[policy]) else "unknown"

        def nanoseconds(name: str) -> int:
            value = int(getattr(profile, name).nanoseconds)
            return value if 0 < value < INFINITE_NS else INFINITE_NS

        return cls(
            history=word("history"),
            depth=int(profile.depth),
            reliability=word("reliability"),
            durability=word("durability"),
            deadline_ns=nanoseconds("deadline"),
            lifespan_ns=nanoseconds("lifespan"),
            liveliness=word("liveliness"),
            lease_ns=nanoseconds("liveliness_lease_duration"),
            avoid_ros_namespace_conventions=bool(profile.avoid_ros_namespace_conventions),
        )

    def text(self) -> str:
        """Returns one YAML list item, as rosbag2 writes it, without a final line break."""

        def duration(name: str, value_ns: int) -> list[str]:
            return [f"{name}:", f"  sec: {value_ns // 10**9}", f"  nsec: {value_ns % 10**9}"]

        lines = [
            f"history: {self.history}",
            f"depth: {self.depth}",
            f"reliability: {self.reliability}",
            f"durability: {self.durability}",
            *duration("deadline", self.deadline_ns),
            *duration("lifespan", self.lifespan_ns),
            f"liveliness: {self.liveliness}",
            *duration("liveliness_lease_duration", self.lease_ns),
            "avoid_ros_namespace_conventions: "
            + ("true" if self.avoid_ros_namespace_conventions else "false"),
        ]
        return "\n".join(("- " if i == 0 else "  ") + line for i, line in enumerate(lines))

    def profile(self) -> Any:
        """Returns an `rclpy.qos.QoSProfile` for a publisher that offers the same."""
        from rclpy.duration import Duration
        from rclpy.qos import (
            DurabilityPolicy,
            HistoryPolicy,
            LivelinessPolicy,
            QoSProfile,
            ReliabilityPolicy,
        )

        keep_all = self.history == "keep_all"
        timed = {
            name: Duration(nanoseconds=value)
            for name, value in (
                ("deadline", self.deadline_ns),
                ("lifespan", self.lifespan_ns),
                ("liveliness_lease_duration", self.lease_ns),
            )
            if value < INFINITE_NS
        }
        return QoSProfile(
            history=HistoryPolicy.KEEP_ALL if keep_all else HistoryPolicy.KEEP_LAST,
            depth=self.depth or DEFAULT_DEPTH,
            reliability=(
                ReliabilityPolicy.BEST_EFFORT
                if self.reliability == "best_effort"
                else ReliabilityPolicy.RELIABLE
            ),
            durability=(
                DurabilityPolicy.TRANSIENT_LOCAL
                if self.durability == "transient_local"
                else DurabilityPolicy.VOLATILE
            ),
            liveliness=(
                LivelinessPolicy.MANUAL_BY_TOPIC
                if self.liveliness == "manual_by_topic"
                else LivelinessPolicy.AUTOMATIC
            ),
            **timed,
        )


def profiles_text(profiles: Iterable[OfferedQos]) -> str:
    """Returns the YAML list of several profiles, as in the metadata of an MCAP channel.

    Args:
        profiles: Profiles of the publishers of one topic.
    """
    return "\n".join(profile.text() for profile in profiles)


def parse_profiles(found: Any, where: str) -> list[OfferedQos]:
    """Reads the offered profiles of a topic.

    Args:
        found: YAML text (MCAP channels, metadata before version 9) or the parsed list.
        where: File and topic, for the error message.

    Raises:
        InputError: The text is no list of profiles.
    """
    if isinstance(found, str):
        found = parse_yaml(found, f"{where}: offered_qos_profiles", "list of profiles")
    if found is None:
        return []
    if not isinstance(found, list) or not all(isinstance(item, dict) for item in found):
        raise InputError(f"{where}: offered_qos_profiles is a list of mappings, found {found!r}")
    try:
        return [_parse(item, where) for item in found]
    except InputError:  # before its base, ValueError
        raise
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{where}: a QoS profile cannot be read ({error})") from None


def _parse(item: dict[str, Any], where: str) -> OfferedQos:
    def word(policy: str) -> str:
        value = item.get(policy, "unknown")
        words = _WORDS[policy]
        if isinstance(value, int) and 0 <= value < len(words):
            return words[value]
        if value not in words:
            raise InputError(
                f"{where}: {policy} of a QoS profile is one of {', '.join(words)}, found {value!r}"
            )
        return str(value)

    def nanoseconds(name: str) -> int:
        value = item.get(name) or {}
        total = int(value.get("sec", 0)) * 10**9 + int(value.get("nsec", 0))
        # zero is how rmw says "default", which is without limit
        return total if 0 < total < INFINITE_NS else INFINITE_NS

    return OfferedQos(
        history=word("history"),
        depth=int(item.get("depth", 0)),
        reliability=word("reliability"),
        durability=word("durability"),
        deadline_ns=nanoseconds("deadline"),
        lifespan_ns=nanoseconds("lifespan"),
        liveliness=word("liveliness"),
        lease_ns=nanoseconds("liveliness_lease_duration"),
        avoid_ros_namespace_conventions=bool(item.get("avoid_ros_namespace_conventions", False)),
    )


def adapt_to_publishers(offers: list[OfferedQos], depth: int) -> OfferedQos:
    """Returns what a subscription asks for so that it matches every publisher of a topic.

    As rosbag2 does: reliable and transient local only where all publishers offer it.

    Args:
        offers: What the publishers offer; at least one.
        depth: Length of the subscription's history.
    """
    reliable = all(offer.reliability == "reliable" for offer in offers)
    latched = all(offer.durability == "transient_local" for offer in offers)
    return OfferedQos(
        depth=depth,
        reliability="reliable" if reliable else "best_effort",
        durability="transient_local" if latched else "volatile",
    )


def adapt_to_recorded(offers: list[OfferedQos]) -> OfferedQos:
    """Returns what a publisher offers that stands for all recorded publishers of a topic.

    Args:
        offers: Recorded profiles; may be empty.
    """
    if not offers:
        return OfferedQos()
    weakest = adapt_to_publishers(offers, max(offer.depth for offer in offers) or DEFAULT_DEPTH)
    if all(offer == offers[0] for offer in offers):
        return dataclasses.replace(offers[0], depth=offers[0].depth or DEFAULT_DEPTH)
    return weakest
