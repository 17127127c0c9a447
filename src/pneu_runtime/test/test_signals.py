# SPDX-License-Identifier: Apache-2.0
"""A signal that comes while the library hands a message over ends a process as any other does."""

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.kernel_free

PROGRAM = """
import signal
import sys
import threading
import time

from cyclonedds import internal

import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String

# within what the library calls, as if the signal had come there
CONSTRUCTOR = '''
def __init__(self, *values):
    if left and get_ident() == main:
        raise_signal(left.pop())
    constructor(self, *values)
'''
space = internal.__dict__
space["constructor"] = internal.SampleInfo.__init__
space["raise_signal"] = signal.raise_signal
space.update(left=[], get_ident=threading.get_ident, main=threading.get_ident())
exec(CONSTRUCTOR, space)
internal.SampleInfo.__init__ = space["__init__"]

rclpy.init()
node = rclpy.create_node("interrupted")
publisher = node.create_publisher(String, "itself", 10)
heard = node.create_subscription(String, "itself", lambda message: None, 10)
timer = node.create_timer(0.02, lambda: publisher.publish(String(data="x")))
space["left"].append(int(sys.argv[1]))
try:
    rclpy.spin(node)
    time.sleep(20.0)  # ended by a signal that is not lost
    print("slept out", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
except ExternalShutdownException:
    print("shut down", flush=True)
finally:
    node.destroy_node()
    rclpy.try_shutdown()
"""


def test_an_interrupt_while_a_message_is_handed_over(tmp_path):
    """Raised a little later; at once it made the library use a null pointer."""
    script = tmp_path / "program.py"
    script.write_text(PROGRAM)
    words = [sys.executable, "-m", "pneu_runtime", str(script), str(int(signal.SIGINT))]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60.0, check=False)
    assert (done.returncode, done.stdout.split()) == (0, ["interrupted"]), done.stderr
