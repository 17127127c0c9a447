# SPDX-License-Identifier: Apache-2.0
"""How the cost of the gas grows with cells, rigs and threads, as one picture."""

from __future__ import annotations

import os
from typing import Any

from benchmarks.gpu import rate
from benchmarks.report import PAGE, Table
from pneu_sim.device import Device

CELLS = (30, 60, 100, 200, 500, 1000, 2000, 6000)
RIGS = (1, 4, 16, 64, 256, 1024, 4096)
LINES = (30, 200)
ORDERS = {1: "first order", 2: "second order"}
PICTURE = PAGE.parent / "figures" / "growth.png"
TICKS = (5, 10, 20, 40, 80)
WORK = 2_000_000
"""Cells times steps of a run, at least 100 steps."""


def _ns(rigs: int, order: int, cells: int, threads: int = 1) -> float:
    """Nanoseconds per cell and step."""
    steps = max(100, WORK // (cells * rigs))
    return 1e9 / rate(rigs, order, Device.CPU, steps, cells, threads)


def measure() -> list[Table]:
    """Measures all three, and draws them."""
    columns = {"what": "what grows", "count": "to", "order": "scheme", "ns": "ns per cell and step"}
    table = Table(
        "How cost grows",
        "The rig of the kernel's table: its cells, one rig on one thread; rigs of 30 and of 200"
        " cells side by side on one thread; threads that share 256 rigs of 200 cells.",
        columns,
        picture=PICTURE.name,
    )

    def add(what: str, count: int, order: int, ns: float) -> None:
        table.rows.append({"what": what, "count": count, "order": ORDERS[order], "ns": ns})

    threads = sorted({1, *(2**k for k in range(12) if 2**k < os.cpu_count()), os.cpu_count()})
    for order in ORDERS:
        for cells in CELLS:
            add("cells", cells, order, _ns(1, order, cells))
        for cells in LINES:
            for rigs in RIGS:
                add(f"rigs of {cells} cells", rigs, order, _ns(rigs, order, cells))
        for count in threads:
            add("threads", count, order, _ns(256, order, 200, count))
    _draw(table.rows)
    return [table]


def _draw(rows: list[dict[str, Any]]) -> None:
    """The picture: a panel for cells, for rigs and for threads."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 3, figsize=(11.0, 3.6), constrained_layout=True)
    shades = {1: "tab:blue", 2: "tab:orange"}
    for order, name in ORDERS.items():
        for panel, kinds in zip(
            panels,
            (["cells"], [f"rigs of {cells} cells" for cells in LINES], ["threads"]),
            strict=True,
        ):
            for dash, kind in zip(("-", "--"), kinds, strict=False):
                of = [r for r in rows if r["what"] == kind and r["order"] == name]
                label = name if len(kinds) == 1 else f"{name}, {kind.removeprefix('rigs of ')}"
                x, y = [r["count"] for r in of], [r["ns"] for r in of]
                panel.loglog(x, y, dash, marker="o", ms=3, color=shades[order], label=label)
    for panel, title in zip(
        panels,
        ("cells of one rig", "rigs side by side, one thread", "threads, 256 rigs of 200 cells"),
        strict=True,
    ):
        panel.set_xlabel(title)
        panel.grid(True, which="both", alpha=0.25)
        panel.set_ylim(5.0, 80.0)
        panel.set_yticks(TICKS, [str(tick) for tick in TICKS])
        panel.minorticks_off()
        panel.legend(fontsize=7)
    panels[0].set_ylabel("ns per cell and step")
    counts = sorted({row["count"] for row in rows if row["what"] == "threads"})
    panels[2].set_xticks(counts, [str(count) for count in counts])
    figure.savefig(PICTURE, dpi=110)
    plt.close(figure)
