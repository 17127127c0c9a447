# SPDX-License-Identifier: Apache-2.0
"""Commands that only read run where neither installation nor home nor folder can be written."""

import subprocess
import sys
from pathlib import Path

import pytest
from tests import read_only
from tests.domains import own_domain_id

ROOT = Path(__file__).parent.parent
RIG = str(ROOT / "rigs" / "rig_a_fitted.yaml")
BAG = str(ROOT / "data" / "bags" / "a_leak")
LAUNCH = "launch:\n- executable: {cmd: 'echo it runs', name: one, output: screen}\n"


@pytest.fixture(scope="module")
def locked(tmp_path_factory):
    """Runs the `pneu` command in such surroundings; returns status, output and errors."""
    folder = tmp_path_factory.mktemp("locked")
    installed = read_only.installation(folder / "installed")
    (folder / "home").mkdir()
    (folder / "home" / "own.launch.yaml").write_text(LAUNCH)
    read_only.lock(folder)
    environment = read_only.environment(installed, folder / "home")
    environment["ROS_DOMAIN_ID"] = str(own_domain_id())

    def run(*words):
        done = subprocess.run(
            [sys.executable, "-m", "pneu_common.entry", *words],
            cwd=folder / "home",
            env=environment,
            capture_output=True,
            text=True,
            preexec_fn=read_only.bound_by_permissions,
        )
        return done.returncode, done.stdout, done.stderr

    yield run
    read_only.unlock(folder)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["check", RIG], "74 cells"),
        (["bag", "info", BAG], "a_leak.mcap"),
        (["interface", "show", "std_msgs/msg/String"], "string data"),
        (["launch", "--print", "own.launch.yaml"], "echo"),
    ],
    ids=lambda given: given[0] if isinstance(given, list) else "",
)
def test_it_only_reads(locked, words, said):
    status, output, errors = locked(*words)
    assert (status, errors) == (0, "") and said in output


def test_a_launch_runs_without_a_log_and_says_so_once(locked):
    status, output, errors = locked("launch", "own.launch.yaml")
    assert (status, errors) == (0, "")
    assert "it runs" in output
    (warning,) = [line for line in output.splitlines() if line.startswith("[WARNING]")]
    assert "No log is written" in warning and "ROS_LOG_DIR names another folder" in warning


@pytest.mark.long
def test_kernels_are_compiled_in_memory_and_one_line_says_so(locked):
    status, output, errors = locked("compare", BAG, "--rig", RIG, "--no-refine")
    assert status == 0 and "RMSE" in output, errors
    assert len([line for line in errors.splitlines() if "NUMBA_CACHE_DIR" in line]) == 1
