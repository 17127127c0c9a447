# SPDX-License-Identifier: Apache-2.0
"""Two real seals, dragged to and fro at four pressures: friction is named, and how it grows.

Run ``python examples/seal_friction.py``; it prints tables and draws docs/figures/seals.png, which
needs matplotlib. One seal alone, as a command:
``pneu friction data/seal_friction/KDN_*.csv --rig rigs/seal_kdn.yaml -o fitted.yaml``.
"""

from pathlib import Path

from rich.console import Console

from pneu_sim.rig import load_rig
from pneu_sysid.seals.figures import draw_friction
from pneu_sysid.seals.identify import Identified, identify
from pneu_sysid.seals.reading import read_drag
from pneu_sysid.seals.words import sentence_of, statements_of, tables_of

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "data" / "seal_friction"
FIGURE = ROOT / "docs" / "figures" / "seals.png"
SEALS = {
    "O-ring, 25.7 mm": (ROOT / "rigs" / "seal_oring.yaml", "O-ring257"),
    "KDN, 25 mm": (ROOT / "rigs" / "seal_kdn.yaml", "KDN"),
}
BARS = (1, 3, 5, 7)


def study(name: str, bars: tuple[int, ...] = BARS) -> Identified:
    """Finds the friction of one seal.

    Args:
        name: Its name, of `SEALS`.
        bars: Gauge pressures of the recordings that are used.
    """
    path, begins = SEALS[name]
    rig = load_rig(path)
    return identify(rig, [read_drag(rig, DATA / f"{begins}_{bar}bar.csv") for bar in bars])


def main() -> None:
    """Prints the tables and draws the figure."""
    console = Console(width=140)
    seals = [(name, study(name)) for name in SEALS]
    for name, found in seals:
        console.print(f"\n{name}")
        for table in tables_of(found):
            console.print(table)
        console.print(sentence_of(found))
        for statement in statements_of(found):
            console.print(statement)
    draw_friction(seals, FIGURE)
    console.print(f"wrote {FIGURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
