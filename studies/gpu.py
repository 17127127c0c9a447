# SPDX-License-Identifier: Apache-2.0
"""The gas on this machine's GPU: what it computes beside the processor, and how fast both are.

    python -m studies.gpu

Every case is run for a thousand steps, or for thirty where rounding itself would grow too far in a
thousand: told is what the processor's own answer changes by where the gas at the start is changed
by a part in 1e15. The exit status is 1 where there is no GPU, or where anything that steps change
differs by more than 1e-9 of the largest of its kind in double precision.
"""

import multiprocessing
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor

from benchmarks import gpu, report, timing
from benchmarks.report import Table
from rich.console import Console
from src.pneu_sim.test.cuda_cases import EFFECTS, difference, sensitivity

from pneu_sim.cuda.launch import missing
from pneu_sim.device import Device

STEPS = (1000, 30)
MOST = 1e-9
TAME = 1e-11
"""How far rounding may grow in a run that is compared."""
ALSO_SINGLE = "walls"
"""What is computed in single precision as well."""

Row = dict[str, float | int | str | None]


def examined(case: str, order: int) -> Row:
    """A row of the table: a case on the GPU beside the processor.

    Args:
        case: Which.
        order: Of the scheme.
    """
    for steps in STEPS:
        own = sensitivity(case, order, "hllc", steps)
        if own < TAME:
            break
    worst, of = difference(case, order, "hllc", steps, Device.CUDA)
    single = None
    if case == ALSO_SINGLE:
        single, _ = difference(case, order, "hllc", steps, Device.CUDA32)
    return {
        "case": case,
        "order": order,
        "steps": steps,
        "own": own,
        "double": worst,
        "of": of,
        "single": single,
    }


def compared(rows: Sequence[Row]) -> Table:
    """The table of all cases.

    Args:
        rows: Its rows.
    """
    return Table(
        "A GPU beside the processor",
        "Largest difference of anything that steps change, relative to the largest of its kind:"
        " rigs that have every pass between them, read and corrected by what was read. `Rounding`"
        " is what the processor's own answer changes by where the gas at the start is changed by"
        f" a part in 1e15; runs are of {STEPS[0]} steps where that stays below {TAME:g}.",
        {
            "case": "rig",
            "order": "order",
            "steps": "steps",
            "own": "rounding",
            "double": "double",
            "single": "single",
        },
        list(rows),
    )


def main() -> int:
    """Compares and measures; returns the exit status."""
    console = Console()
    if why := missing():
        console.print(f"nothing was compared: {why}", markup=False)
        return 1
    cases = [(case, order) for case in EFFECTS for order in (1, 2)]
    apart = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(len(cases), os.cpu_count() or 1), apart) as pool:
        rows = list(pool.map(examined, *zip(*cases, strict=True)))
    agreement, machine = compared(rows), timing.machine()
    report.show(agreement, console)
    report.keep({"agreement of a GPU": [agreement]}, machine, "make gpu")
    tables = gpu.measure()
    for table in tables:
        report.show(table, console)
    report.keep({"gpu": tables}, machine)
    wrong = [row for row in rows if not float(row["double"] or 0.0) <= MOST]
    for row in wrong:
        console.print(f"{row['case']}, order {row['order']}: {row['of']} differs", style="red")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
