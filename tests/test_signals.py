# SPDX-License-Identifier: Apache-2.0
"""SIGINT and SIGTERM end every command at any moment of its start, and nothing is left of it."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.domains import own_domain_id

from pneu_common.entry import COMMAND

ROOT = Path(__file__).parent.parent
RIG = str(ROOT / "rigs" / "rig_a_fitted.yaml")
BAG = str(ROOT / "data" / "bags" / "a_leak")

LAUNCH = """launch:
- node: {pkg: pneu_sim, exec: simulator, name: simulator, param: [{name: rig, value: RIG}]}
"""

# What is run, and for how long a signal has something to interrupt, s.
TOOLS = {
    "topics": (["topic", "list"], 2.5),
    "nodes": (["node", "list"], 2.5),
    "echo": (["topic", "echo", "/chatter", "std_msgs/msg/String"], 2.5),
    "check": (["check", RIG], 1.5),
    "simulate": (["simulate", "--rig", RIG, "--steps", "voltage=5:4,5:4", "-o", "bag"], 4.0),
    "compare": (["compare", BAG, "--rig", RIG, "--json", "compare.json"], 6.0),
}
NODES = {
    "node": (["run", "pneu_sim", "simulator", "--ros-args", "-p", f"rig:={RIG}"], 3.0),
    "launch": (["launch", "own.launch.yaml"], 4.0),
    "record": (["bag", "record", "-a", "-o", "bag"], 2.0),
}


def handles(pid: int, number: int) -> bool:
    """Whether a process has a handler of its own for a signal."""
    with contextlib.suppress(OSError):
        status = Path(f"/proc/{pid}/status").read_text()
        caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
        return bool(int(caught.split()[1], 16) >> (number - 1) & 1)
    return False


def of_session(leader: int) -> list[str]:
    """Command lines of the processes of a session that still run."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            state, _, _, session = (path / "stat").read_text().rsplit(")", 1)[1].split()[:4]
            if int(session) == leader and state != "Z":
                found.append((path / "cmdline").read_text().replace("\0", " "))
    return found


def interrupt(words: list[str], number: int, after_s: float, folder: Path) -> tuple[int, str, bool]:
    """Starts a command and sends a signal some time after it begins to handle signals.

    Before, while Python itself starts, no program has a say.

    Returns:
        Exit status, what it printed to standard error, and whether it had ended by itself.
    """
    folder.mkdir()
    (folder / "own.launch.yaml").write_text(LAUNCH.replace("RIG", RIG))
    scratch = folder / "scratch"
    scratch.mkdir()
    environment = {
        **os.environ,
        "ROS_DOMAIN_ID": str(own_domain_id()),
        "ROS_LOG_DIR": str(folder / "log"),
        "TMPDIR": str(scratch),
    }
    with subprocess.Popen(
        [*COMMAND, *words],
        cwd=folder,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as command:
        try:
            while command.poll() is None and not handles(command.pid, signal.SIGTERM):
                time.sleep(0.002)
            with contextlib.suppress(subprocess.TimeoutExpired):
                command.wait(after_s)
            # Stopped first: it must not end by itself between this check and the signal.
            command.send_signal(signal.SIGSTOP)
            done = command.poll() is not None
            if not done:
                state = os.waitid(os.P_PID, command.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
                done = state is not None and state.si_code != os.CLD_STOPPED
            command.send_signal(number)
            command.send_signal(signal.SIGCONT)
            _, errors = command.communicate(timeout=60.0)
            end = time.monotonic() + 5.0
            while (left := of_session(command.pid)) and time.monotonic() < end:
                time.sleep(0.05)
            assert not left
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(command.pid, signal.SIGKILL)
    assert not list(scratch.iterdir())
    assert "Traceback" not in errors and "error inside" not in errors, errors
    assert not list(folder.rglob(".*.part")), errors
    return command.returncode, errors, done


def check(name: str, number: int, after_s: float, folder: Path) -> None:
    words, _ = {**TOOLS, **NODES}[name]
    status, errors, done = interrupt(words, number, after_s, folder)
    if done:
        assert status == 0, errors
        return
    # By the signal itself once there is no work left, and before a node takes signals over.
    allowed = {128 + number, -number}
    if name in NODES:  # an ordinary end, as soon as it runs
        allowed.add(0)
    assert status in allowed, (after_s, errors)
    if status > 0:
        word = "interrupted" if number == signal.SIGINT else "terminated"
        assert errors.splitlines()[-1] == f"pneu: {word}"


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize(
    ("name", "number", "share"),
    [
        ("topics", signal.SIGTERM, 0.1),
        ("topics", signal.SIGTERM, 0.4),
        ("topics", signal.SIGINT, 0.3),
        ("simulate", signal.SIGTERM, 0.4),
        ("node", signal.SIGTERM, 0.2),
        ("launch", signal.SIGTERM, 0.15),
    ],
)
def test_a_signal_ends_a_command_while_it_starts(name, number, share, tmp_path):
    check(name, number, share * {**TOOLS, **NODES}[name][1], tmp_path / "folder")


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("name", [*TOOLS, *NODES])
def test_signals_end_commands_at_any_moment(name, number, tmp_path):
    count = 12
    draws = random.Random(f"{name} {number}")
    _, seconds = {**TOOLS, **NODES}[name]
    for k in range(count):
        after_s = seconds * (k + draws.random()) / count
        check(name, number, after_s, tmp_path / str(k))
