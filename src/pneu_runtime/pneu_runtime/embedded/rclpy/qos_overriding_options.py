# SPDX-License-Identifier: Apache-2.0
"""QoS policies of a publisher or subscription that read-only parameters may override."""

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult

from rclpy.duration import Duration
from rclpy.exceptions import ParameterAlreadyDeclaredException
from rclpy.publisher import Publisher
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.subscription import Subscription

if TYPE_CHECKING:
    from rclpy.node import Node

QosCallbackResult = SetParametersResult
QosCallbackType = Callable[[QoSProfile], SetParametersResult]

_ENUMS: dict[QoSPolicyKind, Any] = {
    QoSPolicyKind.HISTORY: HistoryPolicy,
    QoSPolicyKind.RELIABILITY: ReliabilityPolicy,
    QoSPolicyKind.DURABILITY: DurabilityPolicy,
    QoSPolicyKind.LIVELINESS: LivelinessPolicy,
}
_DURATIONS = (
    QoSPolicyKind.LIFESPAN,
    QoSPolicyKind.DEADLINE,
    QoSPolicyKind.LIVELINESS_LEASE_DURATION,
)


class InvalidQosOverridesError(Exception):
    """The validation callback refused a profile with its overrides."""


class QoSOverridingOptions:
    """Which policies may be overridden, and who checks the outcome."""

    def __init__(
        self,
        policy_kinds: Iterable[QoSPolicyKind],
        *,
        callback: QosCallbackType | None = None,
        entity_id: str | None = None,
    ) -> None:
        """Say which policies get a parameter.

        Args:
            policy_kinds: The policies.
            callback: Checks the profile after the overrides.
            entity_id: Tells apart several publishers or subscriptions of one topic.
        """
        self._policy_kinds = policy_kinds
        self._callback = callback
        self._entity_id = entity_id

    @property
    def policy_kinds(self) -> Iterable[QoSPolicyKind]:
        """Policies that get a parameter."""
        return self._policy_kinds

    @property
    def callback(self) -> QosCallbackType | None:
        """Function that checks the profile."""
        return self._callback

    @property
    def entity_id(self) -> str | None:
        """Identifier among several on one topic."""
        return self._entity_id

    @classmethod
    def with_default_policies(
        cls, *, callback: QosCallbackType | None = None, entity_id: str | None = None
    ) -> "QoSOverridingOptions":
        """Return options for history, depth and reliability.

        Args:
            callback: Checks the profile after the overrides.
            entity_id: Tells apart several publishers or subscriptions of one topic.
        """
        return cls(
            (QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY),
            callback=callback,
            entity_id=entity_id,
        )


def _declare_qos_parameters(
    entity_type: type,
    node: "Node",
    topic_name: str,
    qos: QoSProfile,
    options: QoSOverridingOptions,
) -> None:
    """Declare `qos_overrides.<topic>.<entity>.<policy>` and apply the values to `qos`.

    The topic name is the full one, after remapping.
    """
    if not issubclass(entity_type, Publisher | Subscription):
        raise TypeError("Argument `entity_type` should be a subclass of Publisher or Subscription")
    entity = "publisher" if issubclass(entity_type, Publisher) else "subscription"
    suffix = "" if options.entity_id is None else f"_{options.entity_id}"
    about = f" for {entity} `{topic_name}` with id `{options.entity_id}`"
    for policy in options.policy_kinds:
        if policy == QoSPolicyKind.LIFESPAN and entity == "subscription":
            continue  # a subscription has none
        policy_name = policy.name.lower()
        name = f"qos_overrides.{topic_name}.{entity}{suffix}.{policy_name}"
        try:
            parameter = node.declare_parameter(
                name,
                _policy_to_parameter(qos, policy),
                ParameterDescriptor(description=policy_name + about, read_only=True),
            )
        except ParameterAlreadyDeclaredException:
            parameter = node.get_parameter(name)
        _override(qos, policy, parameter.value)
    if options.callback is not None:
        result = options.callback(qos)
        if not result.successful:
            raise InvalidQosOverridesError(
                f"Provided QoS overrides{about}, are not valid: {result.reason}"
            )


def _policy_to_parameter(qos: QoSProfile, policy: QoSPolicyKind) -> str | int | bool:
    value = getattr(qos, policy.name.lower())
    if policy in _ENUMS:
        text = str(value.name).lower()
        if text == "unknown":
            raise ValueError("User provided QoS profile is invalid")
        return text
    if isinstance(value, Duration):
        return int(value.nanoseconds)
    return bool(value) if isinstance(value, bool) else int(value)


def _override(qos: QoSProfile, policy: QoSPolicyKind, value: Any) -> None:
    if policy in _ENUMS:
        try:
            value = _ENUMS[policy][value.upper()]
        except KeyError:
            message = f"Unexpected QoS override for policy `{policy.name.lower()}`: `{value}`"
            raise RuntimeError(message) from None
    elif policy in _DURATIONS:
        value = Duration(nanoseconds=value)
    setattr(qos, policy.name.lower(), value)
