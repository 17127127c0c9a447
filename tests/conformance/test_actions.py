# SPDX-License-Identifier: Apache-2.0
"""Actions: goals, feedback, results, cancelling, and how they show in the graph."""

import threading
import time
from types import SimpleNamespace

import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from pneu_msgs.action import Identify
from rclpy.action import (
    ActionClient,
    ActionServer,
    CancelResponse,
    GoalResponse,
    get_action_client_names_and_types_by_node,
    get_action_names_and_types,
    get_action_server_names_and_types_by_node,
)
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import qos_profile_action_status_default
from unique_identifier_msgs.msg import UUID

pytestmark = pytest.mark.kernel_free


def run_and_succeed(handle):
    handle.succeed()
    return Identify.Result()


class Pair:
    """A server and a client of the action /identify, in two nodes."""

    def __init__(self, ros):
        self.ros = ros
        self.serving = ros.node("serving")
        self.asking = ros.node("asking")
        self.client = ActionClient(self.asking, Identify, "identify")
        self.server = None

    def serve(self, execute=run_and_succeed, **kwargs):
        group = ReentrantCallbackGroup()
        self.server = ActionServer(
            self.serving, Identify, "identify", execute, callback_group=group, **kwargs
        )
        assert self.ros.spin_until(self.client.server_is_ready)

    def send(self, **kwargs):
        return self.ros.result(self.client.send_goal_async(Identify.Goal(), **kwargs))

    def result(self, handle):
        return self.ros.result(handle.get_result_async())


@pytest.fixture
def pair(ros):
    pair = Pair(ros)
    yield pair
    if pair.server is not None:
        pair.server.destroy()
    pair.client.destroy()


def test_a_goal_is_run_and_its_result_returned(pair):
    seen = []

    def execute(handle):
        seen.append((type(handle.request), handle.status, handle.is_active))
        return run_and_succeed(handle)

    pair.serve(execute)
    handle = pair.send()
    assert handle.accepted
    response = pair.result(handle)
    assert response.status == GoalStatus.STATUS_SUCCEEDED
    assert isinstance(response.result, Identify.Result)
    assert seen == [(Identify.Goal, GoalStatus.STATUS_EXECUTING, True)]
    assert pair.ros.spin_until(lambda: handle.status == GoalStatus.STATUS_SUCCEEDED)


def test_there_is_no_server_until_there_is_one(pair):
    assert not pair.client.server_is_ready()
    assert not pair.client.wait_for_server(timeout_sec=0.1)
    pair.serve()
    assert pair.client.wait_for_server(timeout_sec=5.0)


def test_the_result_can_be_asked_for_late_and_often(pair):
    pair.serve()
    handle = pair.send()
    for _ in range(3):
        assert pair.result(handle).status == GoalStatus.STATUS_SUCCEEDED


def test_results_are_forgotten_after_their_time(pair):
    pair.serve(result_timeout=1)
    handle = pair.send()
    assert pair.result(handle).status == GoalStatus.STATUS_SUCCEEDED
    pair.ros.spin_until(lambda: False, timeout_sec=1.5)
    assert pair.result(handle).status == GoalStatus.STATUS_UNKNOWN


def test_feedback_comes_to_the_goal_it_is_about(pair):
    def execute(handle):
        for _ in range(3):
            handle.publish_feedback(Identify.Feedback())
            time.sleep(0.02)
        return run_and_succeed(handle)

    pair.serve(execute)
    received = []
    handle = pair.send(feedback_callback=received.append)
    other = pair.send()
    assert pair.ros.spin_until(lambda: len(received) == 3)
    assert all(message.goal_id == handle.goal_id for message in received)
    assert all(isinstance(message.feedback, Identify.Feedback) for message in received)
    assert pair.result(other).status == GoalStatus.STATUS_SUCCEEDED
    assert len(received) == 3


def test_feedback_of_another_type_raises(pair):
    raised = []

    def execute(handle):
        try:
            handle.publish_feedback(Identify.Goal())
        except TypeError as error:
            raised.append(error)
        return run_and_succeed(handle)

    pair.serve(execute)
    pair.result(pair.send())
    assert len(raised) == 1


def test_a_goal_of_another_type_raises(pair):
    with pytest.raises(TypeError):
        pair.client.send_goal_async("a goal")


def test_goals_can_be_rejected(pair):
    pair.serve(goal_callback=lambda goal: GoalResponse.REJECT)
    assert not pair.send().accepted


def test_a_goal_has_the_identifier_it_was_given(pair):
    pair.serve()
    given = UUID(uuid=list(range(16)))
    handle = pair.send(goal_uuid=given)
    assert (handle.accepted, handle.goal_id) == (True, given)
    assert not pair.send(goal_uuid=given).accepted  # it is taken


@pytest.mark.parametrize("end", ["abort", "raise", "forget"])
def test_goals_that_do_not_succeed_are_aborted(pair, end):
    def execute(handle):
        if end == "abort":
            handle.abort()
        if end == "raise":
            raise RuntimeError("on purpose")
        return Identify.Result()

    pair.serve(execute)
    assert pair.result(pair.send()).status == GoalStatus.STATUS_ABORTED


def test_a_goal_is_cancelled(pair):
    async def execute(handle):
        while not handle.is_cancel_requested:
            future = pair.serving.executor.create_task(lambda: time.sleep(0.01))
            await future
        handle.canceled()
        return Identify.Result()

    pair.serve(execute, cancel_callback=lambda handle: CancelResponse.ACCEPT)
    handle = pair.send()
    response = pair.ros.result(handle.cancel_goal_async())
    assert response.return_code == CancelGoal.Response.ERROR_NONE
    assert [info.goal_id for info in response.goals_canceling] == [handle.goal_id]
    assert pair.result(handle).status == GoalStatus.STATUS_CANCELED


def deferred(pair, **kwargs):
    """Serve goals that wait until they are executed by hand."""
    goals = []
    pair.serve(handle_accepted_callback=goals.append, **kwargs)
    return goals


def test_cancelling_can_be_refused(pair):
    goals = deferred(pair)  # by default nothing is cancelled
    handle = pair.send()
    response = pair.ros.result(handle.cancel_goal_async())
    assert not response.goals_canceling
    goals[0].execute()
    assert pair.result(handle).status == GoalStatus.STATUS_SUCCEEDED


def test_goals_can_be_deferred(pair):
    goals = deferred(pair)
    handle = pair.send()
    assert handle.accepted
    assert goals[0].status == GoalStatus.STATUS_ACCEPTED
    future = handle.get_result_async()
    assert not pair.ros.spin_until(future.done, timeout_sec=0.2)
    goals[0].execute()
    assert pair.ros.result(future).status == GoalStatus.STATUS_SUCCEEDED


def test_a_deferred_goal_is_cancelled_before_it_runs(pair):
    def execute(handle):
        assert handle.is_cancel_requested
        handle.canceled()
        return Identify.Result()

    goals = deferred(pair, execute=execute, cancel_callback=lambda handle: CancelResponse.ACCEPT)
    handle = pair.send()
    assert len(pair.ros.result(handle.cancel_goal_async()).goals_canceling) == 1
    assert goals[0].status == GoalStatus.STATUS_CANCELING
    goals[0].execute()
    assert pair.result(handle).status == GoalStatus.STATUS_CANCELED


def test_all_goals_are_cancelled_at_once(pair):
    goals = deferred(pair, cancel_callback=lambda handle: CancelResponse.ACCEPT)
    handles = [pair.send() for _ in range(3)]
    client = pair.asking.create_client(CancelGoal, "identify/_action/cancel_goal")
    assert pair.ros.spin_until(client.service_is_ready)
    response = pair.ros.result(client.call_async(CancelGoal.Request()))
    cancelled = {bytes(info.goal_id.uuid) for info in response.goals_canceling}
    assert cancelled == {bytes(handle.goal_id.uuid) for handle in handles}
    assert all(goal.is_cancel_requested for goal in goals)


def test_only_goals_up_to_a_time_are_cancelled(pair):
    goals = deferred(pair, cancel_callback=lambda handle: CancelResponse.ACCEPT)
    early = pair.send()
    time.sleep(0.1)
    pair.send()
    client = pair.asking.create_client(CancelGoal, "identify/_action/cancel_goal")
    assert pair.ros.spin_until(client.service_is_ready)
    request = CancelGoal.Request()
    # rcl stamps a goal once more when it keeps it, so a little later than it told who sent it
    until_ns = early.stamp.sec * 10**9 + early.stamp.nanosec + 50_000_000
    request.goal_info.stamp.sec, request.goal_info.stamp.nanosec = divmod(until_ns, 10**9)
    response = pair.ros.result(client.call_async(request))
    assert [info.goal_id for info in response.goals_canceling] == [early.goal_id]
    assert [goal.is_cancel_requested for goal in goals] == [True, False]


def test_a_goal_and_those_up_to_a_time_are_cancelled(pair):
    goals = deferred(pair, cancel_callback=lambda handle: CancelResponse.ACCEPT)
    early = pair.send()
    time.sleep(0.1)
    pair.send()
    named = pair.send()
    client = pair.asking.create_client(CancelGoal, "identify/_action/cancel_goal")
    assert pair.ros.spin_until(client.service_is_ready)
    request = CancelGoal.Request()
    request.goal_info.goal_id = named.goal_id
    until_ns = early.stamp.sec * 10**9 + early.stamp.nanosec + 50_000_000
    request.goal_info.stamp.sec, request.goal_info.stamp.nanosec = divmod(until_ns, 10**9)
    response = pair.ros.result(client.call_async(request))
    cancelled = {bytes(info.goal_id.uuid) for info in response.goals_canceling}
    assert cancelled == {bytes(early.goal_id.uuid), bytes(named.goal_id.uuid)}
    assert [goal.is_cancel_requested for goal in goals] == [True, False, True]


def test_unknown_and_ended_goals_are_not_cancelled(pair):
    pair.serve(cancel_callback=lambda handle: CancelResponse.ACCEPT)
    handle = pair.send()
    pair.result(handle)
    response = pair.ros.result(handle.cancel_goal_async())
    assert response.return_code == CancelGoal.Response.ERROR_GOAL_TERMINATED
    client = pair.asking.create_client(CancelGoal, "identify/_action/cancel_goal")
    assert pair.ros.spin_until(client.service_is_ready)
    request = CancelGoal.Request()
    request.goal_info.goal_id = UUID(uuid=list(range(16)))
    response = pair.ros.result(client.call_async(request))
    assert response.return_code == CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID


def test_states_change_in_their_order_only(pair):
    goals = deferred(pair)
    pair.send()
    with pytest.raises(RuntimeError):
        goals[0].canceled()
    with pytest.raises(RuntimeError):
        goals[0].succeed()
    goals[0].execute()
    assert pair.ros.spin_until(lambda: not goals[0].is_active)
    with pytest.raises(RuntimeError):
        goals[0].abort()


def test_the_status_is_published_for_late_comers(pair):
    pair.serve()
    handle = pair.send()
    pair.result(handle)
    received = []
    pair.asking.create_subscription(
        GoalStatusArray,
        "identify/_action/status",
        received.append,
        qos_profile_action_status_default,
    )
    assert pair.ros.spin_until(lambda: received)
    (status,) = received[-1].status_list
    assert status.goal_info.goal_id == handle.goal_id
    assert status.status == GoalStatus.STATUS_SUCCEEDED


def test_two_clients_do_not_mix_up_their_goals(pair, ros):
    def execute(handle):
        handle.publish_feedback(Identify.Feedback())
        return run_and_succeed(handle)

    pair.serve(execute)
    other = SimpleNamespace(node=ros.node("also_asking"), feedback=[])
    client = ActionClient(other.node, Identify, "identify")
    assert ros.spin_until(client.server_is_ready)
    mine = []
    first = pair.client.send_goal_async(Identify.Goal(), feedback_callback=mine.append)
    second = client.send_goal_async(Identify.Goal(), feedback_callback=other.feedback.append)
    handles = [ros.result(first), ros.result(second)]
    for handle in handles:
        assert pair.result(handle).status == GoalStatus.STATUS_SUCCEEDED
    assert ros.spin_until(lambda: mine and other.feedback)
    assert [message.goal_id for message in mine] == [handles[0].goal_id]
    assert [message.goal_id for message in other.feedback] == [handles[1].goal_id]
    client.destroy()


def test_actions_show_in_the_graph(pair):
    pair.serve()
    expected = [("/identify", ["pneu_msgs/action/Identify"])]
    node = pair.asking
    assert pair.ros.spin_until(lambda: get_action_names_and_types(node) == expected)
    by_node = get_action_server_names_and_types_by_node
    assert pair.ros.spin_until(lambda: by_node(node, "serving", "/") == expected)
    assert by_node(node, "asking", "/") == []
    assert get_action_client_names_and_types_by_node(node, "asking", "/") == expected
    topics = dict(node.get_topic_names_and_types())
    assert topics["/identify/_action/status"] == ["action_msgs/msg/GoalStatusArray"]


def test_a_server_that_is_destroyed_is_gone(pair):
    pair.serve()
    pair.server.destroy()
    assert pair.ros.spin_until(lambda: not pair.client.server_is_ready())
    pair.serve()
    assert pair.result(pair.send()).status == GoalStatus.STATUS_SUCCEEDED


def test_with_several_threads_callbacks_may_block(pair):
    """An execute callback that sleeps is cancelled from another thread, which waits for it."""

    def execute(handle):
        while not handle.is_cancel_requested:
            time.sleep(0.01)
        handle.canceled()
        return Identify.Result()

    pair.serve(execute, cancel_callback=lambda handle: CancelResponse.ACCEPT)
    for node in (pair.serving, pair.asking):
        pair.ros.executor.remove_node(node)
    executor = MultiThreadedExecutor(num_threads=4, context=pair.ros.context)
    executor.add_node(pair.serving)
    executor.add_node(pair.asking)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    accepted = threading.Event()
    sent = pair.client.send_goal_async(Identify.Goal())
    sent.add_done_callback(lambda future: accepted.set())
    assert accepted.wait(10.0)
    handle = sent.result()
    assert len(handle.cancel_goal().goals_canceling) == 1
    assert handle.get_result().status == GoalStatus.STATUS_CANCELED
    executor.shutdown(timeout_sec=5.0)
    spinning.join(5.0)
    assert not spinning.is_alive()


def test_sending_can_wait_for_the_result(pair):
    pair.serve()
    outcome = []
    waiting = threading.Thread(
        target=lambda: outcome.append(pair.client.send_goal(Identify.Goal())), daemon=True
    )
    waiting.start()
    assert pair.ros.spin_until(lambda: outcome)
    assert outcome[0].status == GoalStatus.STATUS_SUCCEEDED


def test_several_goals_at_once(pair):  # fewer than the depth of the services' queues
    pair.serve()
    sent = [pair.client.send_goal_async(Identify.Goal()) for _ in range(8)]
    handles = [pair.ros.result(future) for future in sent]
    results = [handle.get_result_async() for handle in handles]
    statuses = {pair.ros.result(future).status for future in results}
    assert statuses == {GoalStatus.STATUS_SUCCEEDED}


SERVER = """
import rclpy
from pneu_msgs.action import Identify
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
import time

def execute(handle):
    for step in range(200):
        if handle.is_cancel_requested:
            handle.canceled()
            return Identify.Result(message="cancelled")
        handle.publish_feedback(Identify.Feedback(stage=str(step)))
        time.sleep(0.05)
        if handle.request.task == "short" and step == 3:
            break
    handle.succeed()
    return Identify.Result(success=True, message="done")

rclpy.init()
node = rclpy.create_node("serving")
server = ActionServer(
    node,
    Identify,
    "identify",
    execute,
    callback_group=ReentrantCallbackGroup(),
    cancel_callback=lambda handle: CancelResponse.ACCEPT,
)
executor = MultiThreadedExecutor(num_threads=3)
executor.add_node(node)
print("ready", flush=True)
try:
    executor.spin()
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


@pytest.mark.long
def test_a_server_in_another_process(ros, start_peer):
    start_peer(SERVER).wait_for_line("ready")
    client = ActionClient(ros.node("asking"), Identify, "identify")
    assert ros.spin_until(client.server_is_ready)

    stages = []
    sent = client.send_goal_async(
        Identify.Goal(task="short"),
        feedback_callback=lambda message: stages.append(message.feedback.stage),
    )
    response = ros.result(ros.result(sent).get_result_async())
    assert response.status == GoalStatus.STATUS_SUCCEEDED
    assert (response.result.success, response.result.message) == (True, "done")
    assert stages == ["0", "1", "2", "3"][-len(stages) :]  # the first ones may precede the match

    handle = ros.result(client.send_goal_async(Identify.Goal(task="long")))
    assert len(ros.result(handle.cancel_goal_async()).goals_canceling) == 1
    response = ros.result(handle.get_result_async())
    assert response.status == GoalStatus.STATUS_CANCELED
    assert response.result.message == "cancelled"
    client.destroy()
