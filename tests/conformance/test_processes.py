# SPDX-License-Identifier: Apache-2.0
"""Two processes: discovery, topics, services, and how a process ends."""

import signal

import pytest
from sensor_msgs.msg import FluidPressure
from std_srvs.srv import SetBool

pytestmark = pytest.mark.kernel_free

PONG = """
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from sensor_msgs.msg import FluidPressure
    from std_srvs.srv import SetBool


    def main():
        rclpy.init()
        node = rclpy.create_node("pong")
        publisher = node.create_publisher(FluidPressure, "pong", 10)
        node.create_subscription(FluidPressure, "ping", publisher.publish, 10)

        def negate(request, response):
            response.success = not request.data
            return response

        node.create_service(SetBool, "negate", negate)

        def look():
            if publisher.get_subscription_count():
                print("matched", flush=True)
                timer.cancel()

        timer = node.create_timer(0.02, look)
        try:
            print("ready", flush=True)
            rclpy.spin(node)
        except ExternalShutdownException:
            print("shut down", flush=True)
        except KeyboardInterrupt:
            print("interrupted", flush=True)
        finally:
            node.destroy_node()
            rclpy.try_shutdown()


    main()
"""


@pytest.fixture
def pong(start_peer):
    peer = start_peer(PONG)
    peer.wait_for_line("ready")
    return peer


@pytest.mark.long
def test_messages_there_and_back(pong, node, executor, spin_until):
    executor.add_node(node)
    received = []
    publisher = node.create_publisher(FluidPressure, "ping", 10)
    subscription = node.create_subscription(FluidPressure, "pong", received.append, 10)
    assert spin_until(lambda: publisher.get_subscription_count() == 1)
    assert spin_until(lambda: subscription.get_publisher_count() == 1)
    # each end finds the other by itself; a publisher that has not, sends to nobody
    pong.wait_for_line("matched")
    sent = [FluidPressure(fluid_pressure=101325.0 + number) for number in range(10)]
    for number, message in enumerate(sent):
        publisher.publish(message)
        assert spin_until(lambda count=number + 1: len(received) == count)
    assert received == sent


@pytest.mark.long
def test_a_call(pong, node, executor):
    executor.add_node(node)
    client = node.create_client(SetBool, "negate")
    assert client.wait_for_service(timeout_sec=20.0)
    for value in (True, False):
        future = client.call_async(SetBool.Request(data=value))
        executor.spin_until_future_complete(future, timeout_sec=20.0)
        assert future.result().success is not value


@pytest.mark.long
def test_the_other_node_is_seen_and_seen_to_go(pong, node, executor, spin_until):
    executor.add_node(node)
    assert spin_until(lambda: "pong" in node.get_node_names(), timeout_s=20.0)
    pong.send_signal(signal.SIGTERM)
    assert pong.wait() == 0
    assert spin_until(lambda: "pong" not in node.get_node_names(), timeout_s=20.0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("number", "lines"),
    [
        (signal.SIGTERM, {"shut down"}),
        # the interpreter's own exception, or the shutdown that the signal brings as well
        (signal.SIGINT, {"interrupted", "shut down"}),
    ],
)
def test_signals_end_a_spin(pong, number, lines):
    pong.send_signal(number)
    assert pong.wait() == 0
    # a spin that had not begun to wait ends without an exception
    assert set(pong.lines) - {"ready"} <= lines


@pytest.mark.long
def test_arguments_reach_the_other_process(start_peer):
    peer = start_peer(
        """
        import sys

        import rclpy
        from rclpy.utilities import remove_ros_args

        rclpy.init()
        node = rclpy.create_node("me")
        print(node.get_fully_qualified_name(), node.resolve_topic_name("a"), flush=True)
        print(remove_ros_args(sys.argv)[1:], flush=True)
        node.destroy_node()
        rclpy.shutdown()
        """,
        "plain",
        "--ros-args",
        "-r",
        "__ns:=/space",
        "-r",
        "a:=b",
    )
    assert peer.wait() == 0
    assert peer.lines == ["/space/me /space/b", "['plain']"]


def test_signals_are_left_alone_where_asked(start_peer):
    peer = start_peer(
        """
        import signal
        import sys

        import rclpy
        from rclpy.signals import SignalHandlerOptions

        signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(7))
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        print("ready", flush=True)
        node = rclpy.create_node("own_signals")
        # the interpreter calls its handlers only when it gets its turn
        node.create_timer(0.05, lambda: None)
        rclpy.spin(node)
        """
    )
    peer.wait_for_line("ready")
    peer.send_signal(signal.SIGTERM)
    assert peer.wait() == 7
