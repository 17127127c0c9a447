# SPDX-License-Identifier: Apache-2.0
"""Nothing that lies in the working folder is run; only packages of interfaces are imported."""

import json
import os
import subprocess
import sys

import pytest

from pneu_common import children
from pneu_common.entry import COMMAND
from pneu_graph.nodes.provenance import provenance
from pneu_graph.nodes.type_support import interface_class
from pneu_graph.tools.executables import command_of

pytestmark = pytest.mark.kernel_free
NO_RIG = ("--ros-args", "-p", "rig:=nowhere.yaml")
TRAP = "import pathlib; pathlib.Path(__file__).with_name('ran').touch()\n"


def test_a_module_in_the_working_folder_is_not_run(tmp_path):
    for name in ("random", "numpy", "json", "pneu_common", "rclpy"):
        (tmp_path / f"{name}.py").write_text(TRAP)
    for command in ([*COMMAND, "--version"], [*command_of("pneu_sim", "simulator"), *NO_RIG]):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, timeout=60.0)
        assert done.returncode in (0, 2), done.stderr
    assert not (tmp_path / "ran").exists()


@pytest.mark.parametrize(
    ("given", "kept"),
    [("", ""), (":/a", "/a"), ("/a::/b:", "/a:/b"), (".:/a:src", "/a"), ("src", "")],
)
def test_the_path_of_modules_has_nothing_of_the_working_folder(monkeypatch, given, kept):
    monkeypatch.setenv("PYTHONPATH", given)
    children.keep_to_installed()
    assert os.environ.get("PYTHONPATH", "") == kept


def test_a_type_s_name_imports_no_other_package(tmp_path):
    (tmp_path / "rig.py").write_text(TRAP)
    code = """
import json, sys
from pneu_common.errors import InputError
from pneu_graph.nodes.type_support import interface_class
sys.path.append(sys.argv[1])
for package in ("antigravity", "this", "turtledemo", "lib2to3", "nowhere", "rig"):
    for kind in ("msg", "srv", "action"):
        try:
            interface_class(f"{package}/{kind}/Thing", kind)
        except InputError as error:
            print(json.dumps([str(error), package in sys.modules]))
"""
    words = [sys.executable, "-P", "-c", code, str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(found) == 18
    assert all("not known here" in said and not imported for said, imported in found)
    assert not (tmp_path / "ran").exists()


def test_interfaces_that_are_here_are_found():
    for name, kind in (
        ("sensor_msgs/msg/FluidPressure", "msg"),
        ("std_srvs/srv/Trigger", "srv"),
        ("pneu_msgs/msg/ValveCommand", "msg"),
    ):
        assert interface_class(name, kind).__name__ == name.rsplit("/", 1)[1]


def git(folder, *words):
    made = ("-c", "user.name=x", "-c", "user.email=x@x", "-c", "commit.gpgsign=false")
    subprocess.run(["git", *made, *words], cwd=folder, check=True, capture_output=True)


def test_the_changes_of_a_received_repository_run_none_of_its_programs(tmp_path, monkeypatch):
    """Those that its configuration names: monitors, filters, hooks."""
    git(tmp_path, "init", "-q")
    for name in ("kept", "changed"):
        (tmp_path / name).write_text("one\n")
    git(tmp_path, "add", "kept", "changed")
    git(tmp_path, "commit", "-qm", "first")
    trap = tmp_path / "trap.sh"
    trap.write_text(f"#!/bin/sh\ntouch {tmp_path}/ran\ncat\n")
    trap.chmod(0o755)
    for key in ("core.fsmonitor", "filter.trap.clean", "filter.trap.smudge", "core.pager"):
        git(tmp_path, "config", key, str(trap))
    hooks = tmp_path / ".git" / "hooks"
    for name in ("post-index-change", "fsmonitor-watchman"):
        (hooks / name).write_text(trap.read_text())
        (hooks / name).chmod(0o755)
    (tmp_path / ".gitattributes").write_text("* filter=trap\n")
    (tmp_path / ".git" / "info" / "attributes").write_text("* filter=trap\n")
    (tmp_path / "changed").write_text("two\n")
    os.utime(tmp_path / "kept", (1, 1))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ran").unlink(missing_ok=True)
    found = provenance()
    assert not (tmp_path / "ran").exists()
    assert found["git_changes"] == "M changed" and len(found["git_revision"]) == 40
    subprocess.run(["git", "status"], capture_output=True)
    assert (tmp_path / "ran").exists(), "the trap works"
    (tmp_path / ".git" / "index").unlink()
    assert provenance()["git_changes"] == "" and provenance()["git_revision"]
