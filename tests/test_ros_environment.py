# SPDX-License-Identifier: Apache-2.0
"""`make ros-venv` stops with one sentence where the genuine rclpy cannot be had."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.kernel_free

ROOT = Path(__file__).parent.parent


def refused(venv, **variables):
    """Runs the builder, which must refuse before it makes anything; returns what it printed."""
    left_out = ("CXX", "ROS_DISTRO", "AMENT_PREFIX_PATH")
    environment = {k: v for k, v in os.environ.items() if k not in left_out} | variables
    command = [sys.executable, str(ROOT / "tools" / "ros_environment.py"), str(venv)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout) == (1, "")
    assert not venv.exists()
    (line,) = done.stderr.splitlines()
    return line


def test_without_a_compiler(tmp_path):
    line = refused(tmp_path / "venv", PATH=str(tmp_path))
    assert "there is no C++ compiler" in line and "apt install g++" in line


def test_beside_a_sourced_ros_of_another_python(tmp_path):
    """The wheels would not work there: both libraries would be on LD_LIBRARY_PATH."""
    (tmp_path / "rclpy.py").write_text("raise ImportError('made for another Python')\n")
    line = refused(tmp_path / "venv", ROS_DISTRO="jazzy", PYTHONPATH=str(tmp_path))
    assert line.startswith("environment: ROS is sourced, but ")
