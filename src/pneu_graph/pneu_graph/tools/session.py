# SPDX-License-Identifier: Apache-2.0
"""A short-lived node for one command of the command line."""

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from pneu_common.errors import InputError
from pneu_runtime import hook

QUIET_S = 0.4
"""The graph is taken for known when it has not changed for so long, s, and for the middleware's
period of announcements besides (`pneu_graph.nodes.discovery`)."""

SERVICE_S = 5.0
"""How long a command waits for a service to be there, once its participant is known, and for its
answer, s."""


@contextlib.contextmanager
def tool_node(
    found: Callable[[Any], bool] | None = None, look_around: bool = True
) -> Iterator[Any]:
    """Yields a node whose name marks it as one of the command line.

    Args:
        found: Whether the node sees what is looked for, which ends the wait.
        look_around: Wait until the graph is known.
    """
    hook.install()
    import rclpy
    from rclpy.exceptions import NameValidationException
    from rclpy.executors import ExternalShutdownException

    from pneu_graph.nodes.lifetime import initialised

    with contextlib.suppress(ExternalShutdownException), initialised([]):
        node = rclpy.create_node(
            f"_ros2cli_{os.getpid()}",
            use_global_arguments=False,
            start_parameter_services=False,
            enable_rosout=False,
        )
        try:
            if look_around:
                settle(node, found)
            yield node
        except NameValidationException as error:  # the rule and the name are lines of its text
            rule, name = str(error).split("\n")[:2]
            raise InputError(f"{rule.rstrip(':')}, found {name.strip()}") from None
        finally:
            node.destroy_node()


def nobody_found(environment: Mapping[str, str]) -> str:
    """Why a command may have found no other node, in a line.

    Args:
        environment: The variables of the process.
    """
    domain = environment.get("ROS_DOMAIN_ID", "") or "0"
    reach = environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "")
    looked = f"ROS_AUTOMATIC_DISCOVERY_RANGE {reach or 'LOCALHOST, as it is not set'}"
    return (
        f"no other node was found in domain {domain} ({looked}); nodes meet where both agree, and a"
        " ROS 2 that is not told otherwise takes SUBNET"
    )


def settle(node: Any, found: Callable[[Any], bool] | None = None) -> None:
    """Waits until the graph has been quiet for a while, as long as the middleware needs.

    Args:
        node: Node that looks.
        found: Whether the node sees what is looked for, which ends the wait.
    """
    from pneu_graph.nodes.discovery import patience_s

    deadline = time.monotonic() + patience_s()
    quiet_s = patience_s(QUIET_S)
    changed = time.monotonic()
    seen: Any = None
    while time.monotonic() < deadline and not (found and found(node)):
        now = (node.get_topic_names_and_types(), node.get_node_names_and_namespaces())
        if now != seen:
            seen, changed = now, time.monotonic()
        # Alone, one cannot know whether others are still to come.
        if time.monotonic() - changed > quiet_s and len(now[1]) > 1:
            return
        spin(node, 0.05)


def spin(node: Any, seconds: float) -> None:
    """Lets a node work for a while.

    Args:
        node: The node.
        seconds: How long, s.
    """
    import rclpy

    end = time.monotonic() + seconds
    while rclpy.ok() and (rest := end - time.monotonic()) > 0.0:
        rclpy.spin_once(node, timeout_sec=rest)


def spin_while(node: Any, going_on: Callable[[], bool], timeout_s: float | None = None) -> bool:
    """Lets a node work until something is done.

    Args:
        node: The node.
        going_on: Whether it is not done yet.
        timeout_s: Longest wait, s; None: without limit.

    Returns:
        Whether it was done in time.
    """
    import rclpy

    end = None if timeout_s is None else time.monotonic() + timeout_s
    while rclpy.ok() and going_on():
        if end is not None and time.monotonic() > end:
            return False
        rclpy.spin_once(node, timeout_sec=0.1)
    return not going_on()


def call(node: Any, service_type: Any, name: str, request: Any, what: str) -> Any:
    """Calls a service and waits for its answer.

    Args:
        node: Node that calls.
        service_type: Class of the service.
        name: Its name.
        request: The request.
        what: Whom one asks, for the error message.

    Returns:
        The response.

    Raises:
        InputError: There is no such service, or it does not answer.
    """
    from pneu_graph.nodes.discovery import patience_s

    client = node.create_client(service_type, name)
    try:
        if not spin_while(node, lambda: not client.service_is_ready(), patience_s(SERVICE_S)):
            raise InputError(f"{what}: service {name} is not there")
        future = client.call_async(request)
        if not spin_while(node, lambda: not future.done(), SERVICE_S):
            raise InputError(f"{what}: service {name} has not answered for {SERVICE_S:g} s")
        return future.result()
    finally:
        node.destroy_client(client)


def full_name(namespace: str, name: str) -> str:
    """Returns the fully qualified name of a node.

    Args:
        namespace: Its namespace.
        name: Its name.
    """
    return f"{namespace.rstrip('/')}/{name}"


def absolute(name: str) -> str:
    """Returns a name of the command line as an absolute one.

    Args:
        name: With or without the leading slash.
    """
    return name if name.startswith("/") else f"/{name}"


def hidden(name: str) -> bool:
    """Returns whether a topic, service or node is hidden by its name.

    Args:
        name: Its fully qualified name.
    """
    return any(part.startswith("_") for part in name.split("/"))
