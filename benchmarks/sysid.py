# SPDX-License-Identifier: Apache-2.0
"""Time and peak memory of `pneu compare` and `pneu learn` on a recording that comes along."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.report import ROOT, Table

BAG = ROOT / "data" / "bags" / "a_leak"
RIG = ROOT / "rigs" / "rig_a_fitted.yaml"
THIN_PLATE = ROOT / "rigs" / "rig_a_thin_plate.yaml"
PNEU = [sys.executable, "-c", "from pneu_common.cli import main; main()"]
# In a small process of its own: Linux counts the memory of the process that starts a command as the
# command's, and this one has measured other subjects before.
LAUNCHER = """
import os, subprocess, sys, time
began = time.perf_counter()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
print(time.perf_counter() - began, usage.ru_maxrss)
sys.exit(os.waitstatus_to_exitcode(status) != 0)
"""


def timed(arguments: list[str]) -> tuple[float, float]:
    """Runs `pneu` as a user does.

    Returns:
        Wall time, s, and peak resident memory, MiB.

    Raises:
        RuntimeError: The command failed.
    """
    with subprocess.Popen(
        [sys.executable, "-c", LAUNCHER, *PNEU, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            said, problems = process.communicate()
        except BaseException:
            os.killpg(process.pid, signal.SIGKILL)  # the command too
            raise
    if process.returncode:
        last = problems.strip().splitlines()[-1:]
        raise RuntimeError(f"pneu {arguments[0]} failed: {' '.join(last)}")
    taken, peak = map(float, said.split())
    return taken, peak / (2**20 if sys.platform == "darwin" else 2**10)


def measure() -> list[Table]:
    """Measures both commands; kernels are compiled before."""
    table = Table(
        "Identification: time and memory of a command",
        f"On `{BAG.relative_to(ROOT)}`, start of Python and reading of the bag included, kernels"
        " compiled before; all cores. `compare` checks the grid too.",
        {"command": "command", "time_s": "time, s", "memory_mib": "peak memory, MiB"},
    )
    if not (BAG.exists() and RIG.exists()):
        table.notes.append(f"{BAG.name} or {RIG.name} is not there: nothing measured.")
        return [table]
    with tempfile.TemporaryDirectory() as folder:
        rigs = ["--rig", str(RIG)]
        both = [*rigs, "--rig", str(THIN_PLATE)] if THIN_PLATE.exists() else rigs
        commands = {
            "compare, one model": ["compare", str(BAG), *rigs],
            "compare, two models": ["compare", str(BAG), *both],
            "learn": ["learn", str(BAG), *rigs, "-o", str(Path(folder) / "learned")],
        }
        timed(commands["compare, two models"])
        for name, arguments in commands.items():
            taken, memory = timed(arguments)
            table.rows.append({"command": name, "time_s": taken, "memory_mib": memory})
    return [table]
