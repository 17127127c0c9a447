# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: N818  # the names are those of rclpy
"""Quality of service: policies, profiles, presets, and which profiles match.

The integers of the policies are those of ROS's middleware interface.
"""

import warnings
from enum import Enum, IntEnum
from typing import Any, TypeVar

from rclpy.duration import Duration, Infinite

_NS_PER_S = 1_000_000_000
# "never", as the middleware interface writes it
_UNLIMITED = Infinite
_UNSPECIFIED = Duration()


class InvalidQoSProfileException(Exception):
    """Raised where a profile cannot be.

    Args:
        *args: What is wrong.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__("Invalid QoSProfile", *args)


class QoSPolicyKind(IntEnum):
    """The policies, as bits."""

    INVALID = 1
    DURABILITY = 2
    DEADLINE = 4
    LIVELINESS = 8
    RELIABILITY = 16
    HISTORY = 32
    LIFESPAN = 64
    DEPTH = 128
    LIVELINESS_LEASE_DURATION = 256
    AVOID_ROS_NAMESPACE_CONVENTIONS = 512


def qos_policy_name_from_kind(policy_kind: QoSPolicyKind | int) -> str:
    """Return the name of a policy.

    Args:
        policy_kind: The policy.

    Returns:
        str: Its name.
    """
    return QoSPolicyKind(policy_kind).name


_Policy = TypeVar("_Policy", bound="QoSPolicyEnum")


class QoSPolicyEnum(IntEnum):
    """Base of the enumerations of one policy's values."""

    @classmethod
    def short_keys(cls) -> list[str]:
        """List the values by the names that command lines and parameters use.

        Returns:
            list[str]: Names in lower case, without "unknown".
        """
        return [name.lower() for name in cls.__members__ if name != "UNKNOWN"]

    @classmethod
    def get_from_short_key(cls, name: str) -> int:
        """Return the value of a name.

        Args:
            name: Its name, in either case.

        Returns:
            int: The value, as a plain number.
        """
        return int(cls[name.upper()].value)

    @property
    def short_key(self) -> str:
        """The name that command lines and parameters use."""
        return self.name.lower()


class HistoryPolicy(QoSPolicyEnum):
    """How many samples are kept."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2
    UNKNOWN = 3


class ReliabilityPolicy(QoSPolicyEnum):
    """Whether lost samples are sent again."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class DurabilityPolicy(QoSPolicyEnum):
    """Whether samples are kept for those who come later."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class LivelinessPolicy(QoSPolicyEnum):
    """How a publisher shows that it is alive."""

    SYSTEM_DEFAULT = 0
    AUTOMATIC = 1
    MANUAL_BY_TOPIC = 3
    UNKNOWN = 4
    BEST_AVAILABLE = 5


QoSHistoryPolicy = HistoryPolicy
QoSReliabilityPolicy = ReliabilityPolicy
QoSDurabilityPolicy = DurabilityPolicy
QoSLivelinessPolicy = LivelinessPolicy


class QoSProfile:
    """A set of policies. History or depth must be given.

    Args:
        **kwargs: ``history``, ``depth``, ``reliability``, ``durability``, ``lifespan``,
            ``deadline``, ``liveliness``, ``liveliness_lease_duration``,
            ``avoid_ros_namespace_conventions``.
    """

    __slots__ = [
        "_avoid_ros_namespace_conventions",
        "_deadline",
        "_depth",
        "_durability",
        "_history",
        "_lifespan",
        "_liveliness",
        "_liveliness_lease_duration",
        "_reliability",
    ]

    _depth: int

    def __init__(self, **kwargs: Any) -> None:
        unknown = [key for key in kwargs if f"_{key}" not in self.__slots__]
        if unknown:
            raise AssertionError(f"Invalid arguments passed to constructor: {', '.join(unknown)}")
        if "history" not in kwargs:
            if "depth" not in kwargs:
                raise InvalidQoSProfileException("History and/or depth settings are required.")
            kwargs["history"] = HistoryPolicy.KEEP_LAST
        if kwargs["history"] == HistoryPolicy.KEEP_LAST:
            if "depth" not in kwargs:
                raise InvalidQoSProfileException(
                    "History set to KEEP_LAST without a depth setting."
                )
            if kwargs["depth"] == 0:
                warnings.warn(
                    "A zero depth with KEEP_LAST doesn't make sense; no data could be stored. "
                    "This will be interpreted as SYSTEM_DEFAULT",
                    stacklevel=2,
                )
        self.history = kwargs["history"]
        self.depth = kwargs.get("depth", 0)
        self.reliability = kwargs.get("reliability", ReliabilityPolicy.RELIABLE)
        self.durability = kwargs.get("durability", DurabilityPolicy.VOLATILE)
        self.lifespan = kwargs.get("lifespan", Duration())
        self.deadline = kwargs.get("deadline", Duration())
        self.liveliness = kwargs.get("liveliness", LivelinessPolicy.SYSTEM_DEFAULT)
        self.liveliness_lease_duration = kwargs.get("liveliness_lease_duration", Duration())
        self.avoid_ros_namespace_conventions = kwargs.get("avoid_ros_namespace_conventions", False)

    @property
    def history(self) -> HistoryPolicy:
        """How many samples are kept."""
        return self._history

    @history.setter
    def history(self, value: HistoryPolicy | int) -> None:
        _check(value, int)
        self._history = HistoryPolicy(value)

    @property
    def depth(self) -> int:
        """How many samples KEEP_LAST keeps."""
        return self._depth

    @depth.setter
    def depth(self, value: int) -> None:
        _check(value, int)
        if value < 0:
            raise ValueError("depth must be greater than or equal to zero")
        self._depth = value

    @property
    def reliability(self) -> ReliabilityPolicy:
        """Whether lost samples are sent again."""
        return self._reliability

    @reliability.setter
    def reliability(self, value: ReliabilityPolicy | int) -> None:
        _check(value, int)
        self._reliability = ReliabilityPolicy(value)

    @property
    def durability(self) -> DurabilityPolicy:
        """Whether samples are kept for those who come later."""
        return self._durability

    @durability.setter
    def durability(self, value: DurabilityPolicy | int) -> None:
        _check(value, int)
        self._durability = DurabilityPolicy(value)

    @property
    def lifespan(self) -> Duration:
        """After what time a sample is no longer handed out; zero for never."""
        return self._lifespan

    @lifespan.setter
    def lifespan(self, value: Duration) -> None:
        _check(value, Duration)
        self._lifespan = value

    @property
    def deadline(self) -> Duration:
        """Longest time between two samples; zero for any."""
        return self._deadline

    @deadline.setter
    def deadline(self, value: Duration) -> None:
        _check(value, Duration)
        self._deadline = value

    @property
    def liveliness(self) -> LivelinessPolicy:
        """How a publisher shows that it is alive."""
        return self._liveliness

    @liveliness.setter
    def liveliness(self, value: LivelinessPolicy | int) -> None:
        _check(value, int)
        self._liveliness = LivelinessPolicy(value)

    @property
    def liveliness_lease_duration(self) -> Duration:
        """Within what time a publisher must show that it is alive; zero for any."""
        return self._liveliness_lease_duration

    @liveliness_lease_duration.setter
    def liveliness_lease_duration(self, value: Duration) -> None:
        _check(value, Duration)
        self._liveliness_lease_duration = value

    @property
    def avoid_ros_namespace_conventions(self) -> bool:
        """Whether the topic stands in DDS under its own name, without ROS's prefix."""
        return self._avoid_ros_namespace_conventions

    @avoid_ros_namespace_conventions.setter
    def avoid_ros_namespace_conventions(self, value: bool) -> None:
        _check(value, bool)
        self._avoid_ros_namespace_conventions = value

    def get_c_qos_profile(self) -> "QoSProfile":
        """Return what the transport takes, which is the profile itself.

        Returns:
            QoSProfile: This profile.
        """
        return self

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, QoSProfile):
            return False
        return all(getattr(self, slot) == getattr(other, slot) for slot in self.__slots__)

    __hash__ = None  # type: ignore[assignment]  # the policies can be changed

    def __str__(self) -> str:
        return f"{type(self).__name__}({', '.join(_parts(self))})"

    __repr__ = __str__


def _check(value: Any, expected: type) -> None:
    if not isinstance(value, expected):
        raise AssertionError(f"expected {expected.__name__}, found {type(value).__name__}")


def _parts(profile: QoSProfile) -> list[str]:
    parts = []
    for slot in profile.__slots__:
        value = getattr(profile, slot)
        if isinstance(value, Enum):
            value = value.name.lower()
        parts.append(f"{slot[1:]}={value}")
    return parts


def _preset(depth: int, **kwargs: Any) -> QoSProfile:
    kwargs.setdefault("history", HistoryPolicy.KEEP_LAST)
    return QoSProfile(depth=depth, **kwargs)


qos_profile_unknown = QoSProfile(
    history=HistoryPolicy.UNKNOWN,
    depth=0,
    reliability=ReliabilityPolicy.UNKNOWN,
    durability=DurabilityPolicy.UNKNOWN,
    liveliness=LivelinessPolicy.UNKNOWN,
)
qos_profile_default = _preset(10)
qos_profile_system_default = QoSProfile(
    history=HistoryPolicy.SYSTEM_DEFAULT,
    depth=0,
    reliability=ReliabilityPolicy.SYSTEM_DEFAULT,
    durability=DurabilityPolicy.SYSTEM_DEFAULT,
)
qos_profile_sensor_data = _preset(5, reliability=ReliabilityPolicy.BEST_EFFORT)
qos_profile_services_default = _preset(10)
qos_profile_parameters = _preset(1000)
qos_profile_parameter_events = _preset(1000)
qos_profile_best_available = _preset(
    10,
    reliability=ReliabilityPolicy.BEST_AVAILABLE,
    durability=DurabilityPolicy.BEST_AVAILABLE,
    liveliness=LivelinessPolicy.BEST_AVAILABLE,
)
qos_profile_rosout_default = _preset(
    1000, durability=DurabilityPolicy.TRANSIENT_LOCAL, lifespan=Duration(seconds=10)
)
qos_profile_action_status_default = _preset(1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class QoSPresetProfiles(Enum):
    """The presets by name; ``.value`` is the profile."""

    UNKNOWN = qos_profile_unknown
    DEFAULT = qos_profile_default
    SYSTEM_DEFAULT = qos_profile_system_default
    SENSOR_DATA = qos_profile_sensor_data
    SERVICES_DEFAULT = qos_profile_services_default
    PARAMETERS = qos_profile_parameters
    PARAMETER_EVENTS = qos_profile_parameter_events
    ACTION_STATUS_DEFAULT = qos_profile_action_status_default
    BEST_AVAILABLE = qos_profile_best_available

    @classmethod
    def short_keys(cls) -> list[str]:
        """List the names in lower case.

        Returns:
            list[str]: The names.
        """
        return [name.lower() for name in cls.__members__ if name != "UNKNOWN"]

    @classmethod
    def get_from_short_key(cls, name: str) -> QoSProfile:
        """Return the profile of a name.

        Args:
            name: Its name, in either case.

        Returns:
            QoSProfile: The profile.
        """
        return cls[name.upper()].value


class QoSCompatibility(IntEnum):
    """Whether a publisher and a subscription match."""

    OK = 0
    WARNING = 1
    ERROR = 2


def qos_check_compatible(
    publisher_qos: QoSProfile, subscription_qos: QoSProfile
) -> tuple[QoSCompatibility, str]:
    """Say whether a publisher and a subscription of these profiles match.

    Args:
        publisher_qos: What the publisher offers.
        subscription_qos: What the subscription requests.

    Returns:
        tuple[QoSCompatibility, str]: WARNING where it depends on what a default stands for; the
        text names the reasons, and is empty where they match.
    """
    errors, doubts = [], []
    offered, requested = publisher_qos, subscription_qos

    reliability = (offered.reliability, requested.reliability)
    if reliability == (ReliabilityPolicy.BEST_EFFORT, ReliabilityPolicy.RELIABLE):
        errors.append("Best effort publisher and reliable subscription")
    elif _undecided(reliability, ReliabilityPolicy.RELIABLE, ReliabilityPolicy.BEST_EFFORT):
        doubts.append(f"Reliability {_names(reliability)}")

    durability = (offered.durability, requested.durability)
    if durability == (DurabilityPolicy.VOLATILE, DurabilityPolicy.TRANSIENT_LOCAL):
        errors.append("Volatile publisher and transient local subscription")
    elif _undecided(durability, DurabilityPolicy.TRANSIENT_LOCAL, DurabilityPolicy.VOLATILE):
        doubts.append(f"Durability {_names(durability)}")

    liveliness = (offered.liveliness, requested.liveliness)
    if liveliness == (LivelinessPolicy.AUTOMATIC, LivelinessPolicy.MANUAL_BY_TOPIC):
        errors.append("Automatic publisher liveliness and manual by topic subscription liveliness")
    elif _undecided(liveliness, LivelinessPolicy.MANUAL_BY_TOPIC, LivelinessPolicy.AUTOMATIC):
        doubts.append(f"Liveliness {_names(liveliness)}")

    for what, given, wanted in (
        ("deadline", offered.deadline, requested.deadline),
        (
            "liveliness lease duration",
            offered.liveliness_lease_duration,
            requested.liveliness_lease_duration,
        ),
    ):
        if wanted in (_UNSPECIFIED, _UNLIMITED):
            continue
        if given in (_UNSPECIFIED, _UNLIMITED):
            errors.append(f"Subscription has a {what}, but publisher does not")
        elif given > wanted:
            errors.append(f"Subscription {what} is less than publisher {what}")

    if errors:
        return QoSCompatibility.ERROR, "; ".join(f"ERROR: {text}" for text in errors) + ";"
    if doubts:
        return QoSCompatibility.WARNING, "; ".join(f"WARNING: {text}" for text in doubts) + ";"
    return QoSCompatibility.OK, ""


def _undecided(pair: tuple[IntEnum, IntEnum], strong: IntEnum, weak: IntEnum) -> bool:
    """Whether the two sides match for some meaning of a default, and not for others."""
    unknown = {"SYSTEM_DEFAULT", "UNKNOWN"}
    offered_open, requested_open = (side.name in unknown for side in pair)
    if not (offered_open or requested_open):
        return False
    offers_all = pair[0] is strong or pair[0].name == "BEST_AVAILABLE"
    wants_little = pair[1] is weak or pair[1].name == "BEST_AVAILABLE"
    return not (offers_all or wants_little)


def _names(pair: tuple[IntEnum, IntEnum]) -> str:
    return f"of publisher is {pair[0].name} and of subscription is {pair[1].name}"
