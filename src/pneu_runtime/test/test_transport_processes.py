# SPDX-License-Identifier: Apache-2.0
"""The transport across processes: discovery without multicast, stalls, signals."""

import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from tests.domains import own_domain_id

from pneu_runtime import interfaces
from pneu_runtime.transport import EndpointQos, Session, TransportError, Waiter

pytestmark = pytest.mark.kernel_free

DOMAIN = own_domain_id()
LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
STRING = "std_msgs/msg/String"
IMAGE = "sensor_msgs/msg/Image"
TRIGGER = "std_srvs/srv/Trigger"
RELIABLE = EndpointQos()

PRELUDE = """
import signal, sys, time
from pneu_runtime import interfaces
from pneu_runtime.transport import EndpointQos, Session, Waiter
session = Session()
node = session.add_node("/", sys.argv[1])
waiter = Waiter()
qos = EndpointQos()
"""
ECHO = """
subscription = session.create_subscription(node, "/ping", "std_msgs/msg/String", qos)
publication = session.create_publication(node, "/pong", "std_msgs/msg/String", qos)
server = session.create_server(node, "/vent", "std_srvs/srv/Trigger", qos)
waiter.attach(subscription)
waiter.attach(server)
reply = interfaces.service_class("std_srvs/srv/Trigger").Response(success=True)
while True:
    for source in waiter.wait():
        while (taken := source.take()) is not None:
            if source is server:
                server.respond(taken[0], interfaces.serialize(reply))
            else:
                publication.publish(taken.data)
"""
LISTEN = """
subscription = session.create_subscription(
    node, "/bulk", "sensor_msgs/msg/Image", EndpointQos(history=2))
print("ready", flush=True)
time.sleep(60)
"""
WAIT = """
print("ready", flush=True)
try:
    waiter.wait()
except KeyboardInterrupt:
    print(time.time(), flush=True)
"""
STAY = """
print("ready", flush=True)
sys.stdin.read()
session.close()
"""


def until(condition, timeout_s=20.0):
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "timed out"
        time.sleep(0.005)


@pytest.fixture
def start():
    """Starts processes in the domain of the test, and ends them."""
    running = []

    def run(program, name="peer", domain_id=DOMAIN):
        process = subprocess.Popen(
            [sys.executable, "-c", PRELUDE + program, name],
            env=os.environ | LOCAL | {"ROS_DOMAIN_ID": str(domain_id)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        running.append(process)
        return process

    yield run
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()
        process.stdin.close()


@pytest.fixture
def session():
    one = Session(DOMAIN, environment=LOCAL)
    yield one
    one.close()


def test_topics_and_services_work_with_multicast_off(session, start):
    start(ECHO)
    node = session.add_node("/", "caller")
    publication = session.create_publication(node, "/ping", STRING, RELIABLE)
    subscription = session.create_subscription(node, "/pong", STRING, RELIABLE)
    client = session.create_client(node, "/vent", TRIGGER, RELIABLE)
    until(lambda: publication.matched_count() and subscription.matched_count())
    until(client.server_is_ready)
    waiter = Waiter()
    waiter.attach(subscription)
    waiter.attach(client)
    cls = interfaces.message_class(STRING)
    sizes = [*range(20), 60_000, 300_000]
    for size in sizes:
        publication.publish(interfaces.serialize(cls(data="x" * size)))
        assert waiter.wait(10) == [subscription]
        sample = subscription.take()
        assert interfaces.deserialize(sample.data, cls).data == "x" * size
    trigger = interfaces.service_class(TRIGGER)
    for number in range(1, 20):
        assert client.send(interfaces.serialize(trigger.Request())) == number
        assert waiter.wait(10) == [client]
        got, data, _ = client.take()
        assert got == number
        assert interfaces.deserialize(data, trigger.Response).success
    waiter.close()
    assert ("peer", "/", "/") in session.node_names()
    (info,) = session.subscriptions_info("/ping")
    assert (info.node_name, info.topic_type_hash) == ("peer", interfaces.type_hash(STRING))


@pytest.mark.long
def test_sixteen_processes_see_one_another(session, start):
    names = [f"peer{number}" for number in range(16)]
    processes = [start(STAY, name) for name in names]
    for process in processes:
        assert process.stdout.readline() == "ready\n"
    until(lambda: {name for name, _, _ in session.node_names()} == set(names))
    for process in processes:
        process.stdin.close()
    until(lambda: session.node_names() == [])


@pytest.mark.long
def test_a_process_that_stalls_stops_no_other_thread(session, start):
    """A reliable writer has to wait for it; the rest of the process must go on."""
    process = start(LISTEN)
    assert process.stdout.readline() == "ready\n"
    node = session.add_node("/", "writer")
    publication = session.create_publication(node, "/bulk", IMAGE, EndpointQos(history=2))
    until(publication.matched_count)
    image = interfaces.message_class(IMAGE)(data=bytes(200_000))
    data = interfaces.serialize(image)
    os.kill(process.pid, signal.SIGSTOP)
    sent, refused = [], []

    def flood():
        try:
            for _ in range(100):
                publication.publish(data)
                sent.append(time.monotonic())
        except TransportError as error:
            refused.append(error)

    thread = threading.Thread(target=flood)
    thread.start()
    worst, last = 0.0, time.monotonic()
    end = last + 2.0
    while last < end:
        time.sleep(0.001)
        now = time.monotonic()
        worst, last = max(worst, now - last), now
    assert thread.is_alive()  # it does wait: else this would show nothing
    assert 0 < len(sent) < 100
    assert worst < 0.2
    os.kill(process.pid, signal.SIGCONT)
    thread.join(20)
    assert (len(sent), refused) == (100, [])


def test_an_interrupt_ends_a_wait_soon(start):
    process = start(WAIT)
    assert process.stdout.readline() == "ready\n"
    time.sleep(0.3)
    sent = time.time()
    process.send_signal(signal.SIGINT)
    noticed = float(process.stdout.readline())
    assert noticed - sent < 0.15


def test_domains_do_not_mix(session, start):
    process = start(STAY, domain_id=DOMAIN % 100 + 101)
    assert process.stdout.readline() == "ready\n"
    time.sleep(0.5)
    assert session.node_names() == []
