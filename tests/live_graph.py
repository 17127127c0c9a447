# SPDX-License-Identifier: Apache-2.0
"""For tests of nodes: a graph of its own on loopback, nodes spun in a thread, and waiting."""

import contextlib
import os
import threading
import time

from pneu_runtime.hook import install

install()

import rclpy  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402
from tests.domains import own_domain_id  # noqa: E402
from tests.measured import PATIENCE_S  # noqa: E402


class Graph:
    """A probe, and whatever nodes a test adds, spun in a thread."""

    def __init__(self) -> None:
        self.executor = SingleThreadedExecutor()
        self.probe = Node("probe")
        self.nodes = [self.probe]
        self.executor.add_node(self.probe)
        self.got: dict[str, list] = {}
        self.thread = threading.Thread(target=self.executor.spin, daemon=True)
        self.thread.start()

    def add(self, make, **parameters):
        """Adds a node with parameters; a double underscore stands for the dot in a name."""
        node = make(
            parameter_overrides=[
                Parameter(key.replace("__", "."), value=value) for key, value in parameters.items()
            ]
        )
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def run_in_executor(self, function):
        """Runs a function in the executor's thread, where services of the life cycle run as well.

        Args:
            function: The function.

        Returns:
            Its result.
        """
        task = self.executor.create_task(function)
        wait_for(task.done, PATIENCE_S)
        return task.result()

    def listen(self, kind, topic, qos=qos_profile_sensor_data):
        got = self.got.setdefault(topic, [])
        self.probe.create_subscription(kind, topic, got.append, qos)
        return got

    def call(self, kind, service, request):
        client = self.probe.create_client(kind, service)
        assert client.wait_for_service(timeout_sec=PATIENCE_S)
        future = client.call_async(request)
        wait_for(future.done)
        return future.result()

    def status(self, part):
        """The newest status of a part that came after this call."""
        seen = self.got.setdefault("/diagnostics", []) or self.listen(
            DiagnosticArray, "/diagnostics", 10
        )
        begin = len(seen)

        def newest():
            for message in reversed(seen[begin:]):
                for status in message.status:
                    if status.name.endswith(part):
                        return status
            return None

        wait_for(newest)
        return newest()

    def mark(self):
        """A place in the diagnostics, to ask later what was told since."""
        if "/diagnostics" not in self.got:
            self.listen(DiagnosticArray, "/diagnostics", 10)
        return len(self.got["/diagnostics"])

    def wait_until_told(self, part, text, since=0, seconds=6.0, level=None):
        """Waits until the diagnostics of a part contain a text, or one of several; the status.

        With a level, those of that level alone: what was published before a fault was seen is no
        answer to it.
        """
        texts = (text,) if isinstance(text, str) else text
        found = []

        def told():
            found[:] = [
                status
                for message in self.got["/diagnostics"][since:]
                for status in message.status
                if status.name.endswith(part)
                and any(one in status.message for one in texts)
                and level in (None, status.level)
            ]
            return found

        try:
            wait_for(told, seconds)
        except AssertionError:
            seen = {
                f"{status.name}: {status.message}"
                for message in self.got["/diagnostics"][since:]
                for status in message.status
            }
            raise AssertionError(f"{part} did not say {text!r}, but {sorted(seen)}") from None
        return found[-1]

    def close(self):
        self.executor.shutdown()
        self.thread.join(5.0)
        for node in self.nodes:
            node.destroy_node()


def wait_for(condition, seconds=6.0):
    """Waits until something is true, with patience."""
    end = time.monotonic() + max(seconds, PATIENCE_S)
    while not condition():
        assert time.monotonic() < end, "it did not come about in time"
        time.sleep(0.01)


def wait_and_see(condition, seconds):
    """Whether something comes about within a time."""
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
    return bool(condition())


@contextlib.contextmanager
def own_domain():
    """Environment of a domain that other tests do not use, on loopback."""
    before = dict(os.environ)
    os.environ["ROS_DOMAIN_ID"] = str(own_domain_id())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    try:
        yield int(os.environ["ROS_DOMAIN_ID"])
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextlib.contextmanager
def running_graph():
    """A graph in a context of its own."""
    rclpy.init()
    try:
        graph = Graph()
        try:
            yield graph
        finally:
            graph.close()
    finally:
        rclpy.try_shutdown()
