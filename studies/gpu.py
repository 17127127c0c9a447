# SPDX-License-Identifier: Apache-2.0
"""The gas on this machine's GPU: a thousand steps beside the processor's, and how fast both are.

    python -m studies.gpu

The exit status is 1 where there is no GPU, or where anything that steps change differs by more than
1e-9 of the largest of its kind in double precision.
"""

import sys

from benchmarks import gpu, report
from rich.console import Console
from src.pneu_sim.test.cuda_cases import EFFECTS, difference

from pneu_sim.cuda.launch import missing
from pneu_sim.device import Device

STEPS = 1000
MOST = 1e-9


def main() -> int:
    """Compares and measures; returns the exit status."""
    console = Console()
    if why := missing():
        console.print(f"nothing was compared: {why}", markup=False)
        return 1
    wrong = 0
    for case in EFFECTS:
        for order in (1, 2):
            worst, of = difference(case, order, "hllc", STEPS, Device.CUDA)
            single, _ = difference(case, order, "hllc", STEPS, Device.CUDA32)
            wrong += worst > MOST
            console.print(f"{case}, order {order}: {worst:.2g} ({of}); single {single:.2g}")
    for table in gpu.measure():
        report.show(table, console)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
