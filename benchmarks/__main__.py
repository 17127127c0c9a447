# SPDX-License-Identifier: Apache-2.0
"""Command line: ``python -m benchmarks [SUBJECT ...]`` measures all subjects, or those named.

With ``--quick`` the graph is measured for seconds instead of minutes, and nothing is written.
"""

from __future__ import annotations

import signal
import sys

from rich.console import Console

from benchmarks import (
    accuracy,
    contacts,
    control,
    gpu,
    graph,
    growth,
    hands,
    kernel,
    passes,
    peers,
    report,
    rig,
    robots,
    sysid,
    timing,
    training,
)
from pneu_sim.cuda import launch

SUBJECTS = {
    "kernel": kernel,
    "passes": passes,
    "growth": growth,
    "gpu": gpu,
    "peers": peers,
    "rig": rig,
    "robots": robots,
    "accuracy": accuracy,
    "sysid": sysid,
    "contacts": contacts,
    "training": training,
    "control": control,
    "hands": hands,
    "graph": graph,
}
QUICK = "--quick"


def main(arguments: list[str]) -> int:
    """Measures the subjects and returns the exit status."""
    names = [word for word in arguments if word != QUICK]
    quick = QUICK in arguments
    unknown = [name for name in names if name not in SUBJECTS]
    if unknown:
        print(f"benchmarks: no subject {unknown[0]!r}; there are {', '.join(SUBJECTS)}")
        return 2
    # So that a benchmark that is ended ends the processes it has started.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    console = Console(width=None if sys.stdout.isatty() else 130)
    for name in names or SUBJECTS:
        with console.status(f"measuring: {name}"):
            tables = graph.measure(quick) if name == "graph" else SUBJECTS[name].measure()
        for table in tables:
            report.show(table, console)
        if name == "gpu" and launch.missing() and report.kept(name):
            console.print("what a GPU was measured to do before stays on the page")
        elif not quick:
            report.keep({name: tables}, timing.machine())
    if not quick:
        shown = [str(path.relative_to(report.ROOT)) for path in (report.PAGE, report.RESULTS)]
        console.print(f"written: {', '.join(shown)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
