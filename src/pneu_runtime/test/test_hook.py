# SPDX-License-Identifier: Apache-2.0
"""Imports of rclpy and messages on a machine without ROS, and beside a real one."""

import subprocess
import sys

import pytest


def run(code, folder, *arguments, **environment):
    """Runs a program in a fresh interpreter, started in a folder."""
    import os

    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(
        command, cwd=folder, env=os.environ | environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_messages_services_and_actions_are_imported(tmp_path):
    code = """
from pneu_runtime import hook
assert hook.install() and hook.install()
import copy, pickle
from std_msgs.msg import *
from pneu_msgs.msg import ValveCommand
from rcl_interfaces.srv import GetParameters, GetParameters_Request
from example_interfaces.action import Fibonacci, Fibonacci_SendGoal
import sensor_msgs.msg
assert GetParameters_Request is GetParameters.Request
assert Fibonacci_SendGoal is Fibonacci.Impl.SendGoalService
command = ValveCommand(name=["v"], voltage_v=[1.0])
assert pickle.loads(pickle.dumps(command)) == copy.deepcopy(command) == command
assert "FluidPressure" in dir(sensor_msgs.msg)
for line in ("from std_msgs.msg import Nope", "import std_msgs.nope", "import no_such_msgs.msg"):
    try:
        exec(line)
    except ImportError:
        continue
    raise SystemExit(f"{line} works")
print(String(data="x"))
"""
    assert run(code, tmp_path) == "std_msgs.msg.String(data='x')"


def test_a_folder_of_definitions_is_not_taken_for_the_package(tmp_path):
    (tmp_path / "std_msgs" / "msg").mkdir(parents=True)
    code = """
import sys
sys.path.insert(0, "")
from pneu_runtime import hook
hook.install()
from std_msgs.msg import String
print(String.__module__)
"""
    assert run(code, tmp_path) == "std_msgs.msg"


def test_the_real_rclpy_is_left_alone(tmp_path):
    for package in ("rclpy", "std_msgs"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("real = True\n")
    code = """
import sys
before = list(sys.meta_path)
from pneu_runtime import hook
assert not hook.install()
assert sys.meta_path == before
import rclpy, std_msgs
assert rclpy.real and std_msgs.real
"""
    run(code, tmp_path, PYTHONPATH=str(tmp_path))


@pytest.mark.long
def test_an_rclpy_that_cannot_be_imported_is_left_out_and_told(tmp_path):
    """As with ROS sourced for another Python: found, but not to be used, nor its messages."""
    for package in ("rclpy", "std_msgs", "std_msgs/msg"):
        (tmp_path / package).mkdir()
        text = "raise ImportError('no native half')\n" if package != "std_msgs" else ""
        (tmp_path / package / "__init__.py").write_text(text)
    (tmp_path / "rclpy" / "__init__.py").write_text("import no_such_yaml\n")
    code = """
import contextlib, io, sys
said = io.StringIO()
with contextlib.redirect_stderr(said):
    from pneu_runtime import hook
    assert hook.install()
import rclpy, rclpy.node
from std_msgs.msg import String
assert "embedded" in rclpy.__file__, rclpy.__file__
assert said.getvalue().count("\\n") == 1
assert "No module named 'no_such_yaml'" in said.getvalue()
print(String(data="x"))
"""
    found = run(code, tmp_path, PYTHONPATH=str(tmp_path))
    assert found == "std_msgs.msg.String(data='x')"


def test_scripts_and_modules_are_run(tmp_path):
    script = tmp_path / "talk.py"
    script.write_text(
        "import sys\nimport beside\nfrom std_msgs.msg import Int8\n"
        "if __name__ == '__main__':\n    print(Int8(data=beside.number), sys.argv[1:])\n"
    )
    (tmp_path / "beside.py").write_text("number = 7\n")
    for command in ([str(script)], ["-m", "talk"]):
        done = subprocess.run(
            [sys.executable, "-m", "pneu_runtime", *command, "--ros-args", "-r", "a:=b"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
        )
        assert done.stdout == "std_msgs.msg.Int8(data=7) ['--ros-args', '-r', 'a:=b']\n", (
            done.stderr
        )


@pytest.mark.parametrize("arguments", [[], ["none.py"]])
def test_nothing_to_run_is_a_mistake(tmp_path, arguments):
    done = subprocess.run(
        [sys.executable, "-m", "pneu_runtime", *arguments],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2
    assert done.stderr
