# SPDX-License-Identifier: Apache-2.0
"""Imports of rclpy and messages on a machine without ROS, and beside a real one."""

import os
import subprocess
import sys

import pytest
from tests.packages import python_path

from pneu_runtime import hook
from pneu_runtime.interfaces import known_types

pytestmark = pytest.mark.kernel_free


def run(code, folder, *arguments, status=0, **environment):
    """Runs a program in a fresh interpreter, started in a folder; returns what it printed."""
    if "PYTHONPATH" in environment:
        environment["PYTHONPATH"] = python_path(environment["PYTHONPATH"])
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        cwd=folder,
        env={k: v for k, v in os.environ.items() if k != hook.CHOICE} | environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == status, done.stderr
    return (done.stdout if status == 0 else done.stderr).strip()


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


@pytest.fixture
def genuine(tmp_path):
    """A folder with rclpy and std_msgs as ROS brings them, and a function that adds pneu_msgs."""
    for package in ("rclpy", "std_msgs", "std_msgs/msg"):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").write_text("genuine = True\n")
    (tmp_path / "rclpy" / "__init__.py").write_text("import std_msgs.msg\ngenuine = True\n")

    def add_pneu_msgs(without=()):
        for kind in ("msg", "srv", "action"):
            folder = tmp_path / "pneu_msgs" / kind
            folder.mkdir(parents=True)
            (folder.parent / "__init__.py").touch()
            names = [n.split("/")[2] for n in known_types() if n.startswith(f"pneu_msgs/{kind}/")]
            lines = [f"class {name}: pass\n" for name in names if name not in without]
            (folder / "__init__.py").write_text("".join(lines))

    return tmp_path, add_pneu_msgs


LEFT_ALONE = """
import os, sys
before = list(sys.meta_path)
from pneu_runtime import hook
assert not hook.install()
assert sys.meta_path == before
assert os.environ["PNEU_RCLPY"] == "ros"
import rclpy, std_msgs
assert rclpy.genuine and std_msgs.genuine
"""

EMBEDDED = """
import contextlib, io, os, subprocess, sys
said = io.StringIO()
with contextlib.redirect_stderr(said):
    from pneu_runtime import hook
    assert hook.install()
import rclpy, rclpy.node
from std_msgs.msg import String
from pneu_msgs.msg import ValveCommand
assert "embedded" in rclpy.__file__, rclpy.__file__
assert os.environ["PNEU_RCLPY"] == "embedded"
code = "from pneu_runtime import hook; assert hook.install()"
child = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
assert (child.returncode, child.stderr) == (0, ""), "a child chooses as we did, and says nothing"
print(String(data="x"), said.getvalue().count("\\n"), said.getvalue())
"""


def test_the_genuine_rclpy_is_used_where_pneu_msgs_is_there_too(genuine):
    folder, add_pneu_msgs = genuine
    add_pneu_msgs()
    run(LEFT_ALONE, folder, PYTHONPATH=str(folder))
    run(LEFT_ALONE, folder, PYTHONPATH=str(folder), PNEU_RCLPY="ros")
    said = run(EMBEDDED, folder, PYTHONPATH=str(folder), PNEU_RCLPY="embedded")
    assert said == "std_msgs.msg.String(data='x') 0"


def test_a_genuine_rclpy_without_pneu_msgs_is_not_used_and_one_line_says_so(genuine):
    """As the wheels of the package index bring it: every node would fail at its first import."""
    folder, add_pneu_msgs = genuine
    said = run(EMBEDDED, folder, PYTHONPATH=str(folder))
    assert said.startswith("std_msgs.msg.String(data='x') 1 pneu: the rclpy in ")
    assert "No module named 'pneu_msgs'" in said and str(folder) in said
    with_choice = run(EMBEDDED, folder, PYTHONPATH=str(folder), PNEU_RCLPY="ros", status=1)
    assert "PNEU_RCLPY=ros asks for the genuine rclpy" in with_choice
    assert "No module named 'pneu_msgs'" in with_choice
    add_pneu_msgs(without=["ValveCommand"])
    said = run(EMBEDDED, folder, PYTHONPATH=str(folder))
    assert "pneu_msgs lacks pneu_msgs/msg/ValveCommand" in said


def test_an_rclpy_that_cannot_be_imported_is_not_used_and_one_line_says_so(genuine):
    """As with ROS sourced for another Python: found, but not to be used, nor its messages."""
    folder, add_pneu_msgs = genuine
    add_pneu_msgs()
    (folder / "rclpy" / "__init__.py").write_text("import std_msgs.msg, no_such_yaml\n")
    said = run(EMBEDDED, folder, PYTHONPATH=str(folder))
    assert said.startswith("std_msgs.msg.String(data='x') 1 pneu: the rclpy in ")
    assert "No module named 'no_such_yaml'" in said


def test_the_choice_is_one_of_two(tmp_path):
    code = "from pneu_runtime import hook; hook.install()"
    said = run(code, tmp_path, PNEU_RCLPY="yes", status=1)
    assert said.endswith("PNEU_RCLPY: found 'yes', allowed are 'ros' and 'embedded'")
    said = run(code, tmp_path, PNEU_RCLPY="ros", status=1)
    assert "no rclpy is installed" in said


def test_packages_are_found_without_a_resource_index(genuine):
    """The genuine `ament_index_python` raises where AMENT_PREFIX_PATH is not set; we do not."""
    folder, add_pneu_msgs = genuine
    add_pneu_msgs()
    (folder / "ament_index_python").mkdir()
    (folder / "ament_index_python" / "__init__.py").write_text("raise OSError('not set')\n")
    code = (
        LEFT_ALONE
        + """
os.environ.pop("AMENT_PREFIX_PATH", None)
from pneu_graph.launch.plan import declared_arguments
from pneu_runtime.packages import package_share
print(*declared_arguments(__import__("pathlib").Path(package_share("pneu_bringup"))
                          / "launch" / "rig.launch.yaml"))
"""
    )
    assert "backend" in run(code, folder, PYTHONPATH=str(folder))


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
