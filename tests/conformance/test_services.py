# SPDX-License-Identifier: Apache-2.0
"""Requests and responses within one process."""

import threading
import time

import pytest
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

pytestmark = pytest.mark.kernel_free


def answer(request, response):
    response.success = request.data
    response.message = "yes" if request.data else "no"
    return response


def test_a_call_is_answered(node, executor, spin_until):
    executor.add_node(node)
    node.create_service(SetBool, "set", answer)
    client = node.create_client(SetBool, "set")
    assert client.service_name == "/set"
    assert client.wait_for_service(timeout_sec=10.0)
    assert client.service_is_ready()
    future = client.call_async(SetBool.Request(data=True))
    executor.spin_until_future_complete(future, timeout_sec=10.0)
    assert future.done()
    assert future.result() == SetBool.Response(success=True, message="yes")


def test_calls_are_told_apart(node, executor):
    executor.add_node(node)
    node.create_service(SetBool, "set", answer)
    client = node.create_client(SetBool, "set")
    other = node.create_client(SetBool, "set")
    assert client.wait_for_service(timeout_sec=10.0) and other.wait_for_service(timeout_sec=10.0)
    values = [True, False, False, True, False]
    futures = [
        (client if index % 2 else other).call_async(SetBool.Request(data=value))
        for index, value in enumerate(values)
    ]
    for future in futures:
        executor.spin_until_future_complete(future, timeout_sec=10.0)
    assert [future.result().success for future in futures] == values


def test_done_callbacks_get_the_future(node, executor, spin_until):
    executor.add_node(node)
    node.create_service(SetBool, "set", answer)
    client = node.create_client(SetBool, "set")
    assert client.wait_for_service(timeout_sec=10.0)
    done = []
    future = client.call_async(SetBool.Request(data=True))
    future.add_done_callback(done.append)
    assert spin_until(lambda: done)
    assert done == [future]


def test_a_service_that_is_not_there(node):
    client = node.create_client(Trigger, "nowhere")
    assert not client.service_is_ready()
    begin_s = time.monotonic()
    assert client.wait_for_service(timeout_sec=0.1) is False
    assert time.monotonic() - begin_s >= 0.1


def test_a_service_that_comes_while_it_is_waited_for(node):
    client = node.create_client(SetBool, "set")
    waited = []
    waiting = threading.Thread(target=lambda: waited.append(client.wait_for_service(20.0)))
    waiting.start()
    waiting.join(0.1)
    assert waiting.is_alive()
    node.create_service(SetBool, "set", answer)
    waiting.join(30.0)
    assert waited == [True]


def test_only_requests_of_the_type_are_sent(node):
    client = node.create_client(SetBool, "set")
    with pytest.raises(TypeError):
        client.call_async(Trigger.Request())


def test_a_pending_request_can_be_removed(node, executor, spin_until):
    executor.add_node(node)
    node.create_service(SetBool, "set", answer)
    client = node.create_client(SetBool, "set")
    assert client.wait_for_service(timeout_sec=10.0)
    dropped = client.call_async(SetBool.Request(data=True))
    client.remove_pending_request(dropped)
    kept = client.call_async(SetBool.Request(data=True))
    assert spin_until(kept.done)
    assert not dropped.done()


def test_a_coroutine_as_a_service(node, executor, spin_until):
    executor.add_node(node)
    gate = Future(executor=executor)

    async def later(request, response):
        response.message = await gate
        response.success = True
        return response

    node.create_service(Trigger, "later", later)
    client = node.create_client(Trigger, "later")
    assert client.wait_for_service(timeout_sec=10.0)
    future = client.call_async(Trigger.Request())
    assert not spin_until(future.done, timeout_s=0.3)
    gate.set_result("now")
    assert spin_until(future.done)
    assert future.result().message == "now"


def test_a_call_from_another_thread(node, spinning):
    node.create_service(SetBool, "set", answer)
    client = node.create_client(SetBool, "set")
    assert client.wait_for_service(timeout_sec=10.0)
    assert client.call(SetBool.Request(data=True)).success


def test_a_call_awaited_in_a_callback(node, executor, spin_until):
    executor.add_node(node)
    node.create_service(SetBool, "set", answer)
    client = node.create_client(SetBool, "set")
    assert client.wait_for_service(timeout_sec=10.0)
    results = []

    async def ask():
        timer.cancel()
        results.append(await client.call_async(SetBool.Request(data=True)))

    # the response would wait for the end of this callback in a group that runs one at a time
    from rclpy.callback_groups import ReentrantCallbackGroup

    timer = node.create_timer(0.01, ask, ReentrantCallbackGroup())
    assert spin_until(lambda: results)
    assert results[0].success


def test_a_destroyed_service_is_gone(node, executor, spin_until):
    executor.add_node(node)
    service = node.create_service(SetBool, "set", answer)
    client = node.create_client(SetBool, "set")
    assert client.wait_for_service(timeout_sec=10.0)
    node.destroy_service(service)
    assert spin_until(lambda: not client.service_is_ready())
