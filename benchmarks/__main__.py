# SPDX-License-Identifier: Apache-2.0
"""Command line: ``python -m benchmarks [SUBJECT ...]`` measures all subjects, or those named."""

from __future__ import annotations

import sys

from rich.console import Console

from benchmarks import accuracy, kernel, peers, report, rig, sysid, timing

SUBJECTS = {"kernel": kernel, "peers": peers, "rig": rig, "accuracy": accuracy, "sysid": sysid}


def main(names: list[str]) -> int:
    """Measures the subjects and returns the exit status."""
    unknown = [name for name in names if name not in SUBJECTS]
    if unknown:
        print(f"benchmarks: no subject {unknown[0]!r}; there are {', '.join(SUBJECTS)}")
        return 2
    console = Console(width=None if sys.stdout.isatty() else 130)
    for name in names or SUBJECTS:
        with console.status(f"measuring: {name}"):
            tables = SUBJECTS[name].measure()
        for table in tables:
            report.show(table, console)
        report.keep({name: tables}, timing.machine())
    shown = [str(path.relative_to(report.ROOT)) for path in (report.PAGE, report.RESULTS)]
    console.print(f"written: {', '.join(shown)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
