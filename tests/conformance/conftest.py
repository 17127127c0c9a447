# SPDX-License-Identifier: Apache-2.0
"""What the conformance tests share. They import rclpy and standard messages only.

Where the genuine rclpy can be imported it is tested, and else the embedded one; PNEU_RCLPY chooses
one of them. The tests are the same. Each run has a DDS domain of its own, on this machine only.
"""

import importlib.util
import os
import random
import subprocess
import sys
import textwrap
import threading
import time

import pytest

if importlib.util.find_spec("rclpy") is None or "PNEU_RCLPY" in os.environ:
    from pneu_runtime import hook

    hook.install()

os.environ["ROS_DOMAIN_ID"] = str(random.SystemRandom().randint(1, 100))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import rclpy
import rclpy.context
import rclpy.executors
import rclpy.node

EMBEDDED = "embedded" in rclpy.__file__
RUNTIME = [sys.executable, "-m", "pneu_runtime"] if EMBEDDED else [sys.executable]


@pytest.fixture
def context():
    """A context that is initialised without arguments."""
    made = rclpy.context.Context()
    rclpy.init(args=[], context=made)
    yield made
    made.try_shutdown()


@pytest.fixture
def make_node(context):
    """Makes nodes that are destroyed at the end."""
    nodes = []

    def make(name="conformance", **options):
        node = rclpy.create_node(name, context=context, **options)
        nodes.append(node)
        return node

    yield make
    for node in nodes:
        node.destroy_node()


@pytest.fixture
def node(make_node):
    return make_node()


@pytest.fixture
def executor(context):
    made = rclpy.executors.SingleThreadedExecutor(context=context)
    yield made
    made.shutdown()


@pytest.fixture
def spin_until(executor):
    """Spins the executor until a condition holds; whether it does."""

    def spin(condition, timeout_s=10.0):
        deadline_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline_s:
                return False
            executor.spin_once(timeout_sec=0.05)
        return True

    return spin


@pytest.fixture
def spinning(context, node):
    """The executor that spins `node` in a thread of its own."""
    made = rclpy.executors.MultiThreadedExecutor(num_threads=4, context=context)
    made.add_node(node)
    failures = []

    def spin():
        try:
            made.spin()
        except rclpy.executors.ExternalShutdownException:
            return
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=spin)
    thread.start()
    yield made
    made.shutdown()
    thread.join(10.0)
    assert not thread.is_alive()
    assert not failures


class Peer:
    """Another process. What it prints is collected line by line."""

    def __init__(self, path, arguments):
        self.process = subprocess.Popen(
            [*RUNTIME, str(path), *arguments], stdout=subprocess.PIPE, text=True
        )
        self.lines = []
        self.changed = threading.Condition()
        self.thread = threading.Thread(target=self._read, daemon=True)
        self.thread.start()

    def _read(self):
        for line in self.process.stdout:
            with self.changed:
                self.lines.append(line.rstrip("\n"))
                self.changed.notify_all()

    def wait_for_line(self, line, timeout_s=20.0):
        with self.changed:
            found = self.changed.wait_for(lambda: line in self.lines, timeout_s)
        assert found, f"'{line}' is not among {self.lines}"

    def send_signal(self, number):
        self.process.send_signal(number)

    def wait(self, timeout_s=20.0):
        status = self.process.wait(timeout_s)
        self.thread.join(5.0)
        return status

    def kill(self):
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.process.stdout.close()


@pytest.fixture
def start_peer(tmp_path):
    """Runs the text of a program in another process, on the runtime that is tested."""
    peers = []

    def start(text, *arguments):
        path = tmp_path / f"peer_{len(peers)}.py"
        path.write_text(textwrap.dedent(text), encoding="utf-8")
        peer = Peer(path, arguments)
        peers.append(peer)
        return peer

    yield start
    for peer in peers:
        peer.kill()


class Ros:
    """Nodes of one context, and the executor that runs them while a test waits."""

    def __init__(self, context, executor):
        self.context = context
        self.executor = executor
        self.nodes = []

    def node(self, name, *, cls=rclpy.node.Node, **options):
        node = cls(name, context=self.context, **options)
        self.nodes.append(node)
        self.executor.add_node(node)
        return node

    def spin_until(self, condition, timeout_sec=10.0):
        """Runs callbacks until a condition holds; returns whether it does."""
        deadline_s = time.monotonic() + timeout_sec
        while not condition():
            if time.monotonic() >= deadline_s:
                return False
            self.executor.spin_once(timeout_sec=0.02)
        return True

    def result(self, future, timeout_sec=10.0):
        """Runs callbacks until a future is done; returns its result."""
        assert self.spin_until(future.done, timeout_sec), "the future was not completed in time"
        return future.result()


@pytest.fixture
def ros(context, executor):
    made = Ros(context, executor)
    yield made
    for node in made.nodes:
        executor.remove_node(node)
        node.destroy_node()
