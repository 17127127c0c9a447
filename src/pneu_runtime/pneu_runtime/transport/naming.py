# SPDX-License-Identifier: Apache-2.0
"""Names on the wire, and the key-value text that endpoints carry in their USER_DATA.

Topic `/a/b` is `rt/a/b`; service `/s` is `rq/sRequest` and `rr/sReply`; type `pkg/msg/Type` is
`pkg::msg::dds_::Type_` (design.ros2.org, "Topic and Service name mapping to DDS";
ros2/rmw_cyclonedds, branch jazzy, namespace_prefix.hpp).
"""

import re

_TYPE = re.compile(r"(?P<package>\w+)::(?P<kind>msg|srv|action)::dds_::(?P<name>\w+)_")
_USER_DATA = re.compile(r"(\w+)=([^;]*);")
_ROS_PREFIXES = ("rt", "rq", "rr")


def topic_to_dds(topic: str, bare: bool = False) -> str:
    """Returns the DDS name of a ROS topic.

    Args:
        topic: Fully qualified name, such as `/rig/valve/command`.
        bare: Whether ROS's prefix is left out (`avoid_ros_namespace_conventions`).
    """
    return topic.lstrip("/") if bare else f"rt{topic}"


def request_to_dds(service: str) -> str:
    """Returns the DDS name of the topic that carries the requests of a service.

    Args:
        service: Fully qualified name.
    """
    return f"rq{service}Request"


def reply_to_dds(service: str) -> str:
    """Returns the DDS name of the topic that carries the replies of a service.

    Args:
        service: Fully qualified name.
    """
    return f"rr{service}Reply"


def topic_from_dds(name: str) -> str | None:
    """Returns the ROS name of a topic, None where it is none.

    Args:
        name: The DDS name.
    """
    return name[2:] if name.startswith("rt/") else None


def service_from_dds(name: str) -> str | None:
    """Returns the ROS name of the service whose requests or replies a topic carries.

    Args:
        name: The DDS name.

    Returns:
        str: the name; None where the topic is of no service.
    """
    for prefix, suffix in (("rq/", "Request"), ("rr/", "Reply")):
        if name.startswith(prefix) and name.endswith(suffix):
            return name[2 : -len(suffix)]
    return None


def type_to_dds(name: str) -> str:
    """Returns the DDS name of a type.

    Args:
        name: Such as `std_msgs/msg/String`.
    """
    package, kind, short = name.split("/")
    return f"{package}::{kind}::dds_::{short}_"


def type_from_dds(name: str) -> str:
    """Returns the ROS name of a type; a name of another kind as it stands.

    Args:
        name: The DDS name.
    """
    match = _TYPE.fullmatch(name)
    return f"{match['package']}/{match['kind']}/{match['name']}" if match else name


def service_type_from_dds(name: str) -> str:
    """Returns the ROS name of the service of a request or reply type.

    Args:
        name: The DDS name of the type.
    """
    ros_name = type_from_dds(name)
    for suffix in ("_Request", "_Response"):
        if ros_name.endswith(suffix):
            return ros_name.removesuffix(suffix)
    return ros_name


def user_data(**values: str) -> bytes:
    """Returns the USER_DATA of an entity.

    Args:
        **values: By key, in order.
    """
    return "".join(f"{key}={value};" for key, value in values.items()).encode()


def parse_user_data(data: bytes) -> dict[str, str]:
    """Reads the USER_DATA of an entity.

    Args:
        data: The bytes; of another vendor they may hold anything.

    Returns:
        dict: the values by key; empty where there are none.
    """
    return dict(_USER_DATA.findall(data.decode("utf-8", "replace")))


def endpoint_id(value: bytes) -> str:
    """Returns the identity of a client or server in USER_DATA: hexadecimal, not padded.

    Args:
        value: 16 bytes.
    """
    return f"{value[0]:2x}." + ".".join(f"{byte:x}" for byte in value[1:])
