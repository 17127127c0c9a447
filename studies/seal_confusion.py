# SPDX-License-Identifier: Apache-2.0
"""Which friction is named for cylinders drawn at random: ``python -m studies.seal_confusion``.

Prints, for each kind of friction that was drawn, what was named, and how far strengths are off in
their standard errors.
"""

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

from pneu_sim.rig import load_rig
from pneu_sysid.seals.identify import Identified, common_terms, identify
from pneu_sysid.seals.reading import read_drag
from studies.dragged import KINDS, Case, draw_case, write_case


def run(case: Case) -> Identified:
    """Identifies one case.

    Args:
        case: The case.
    """
    with tempfile.TemporaryDirectory() as folder:
        rig, files = write_case(case, Path(folder))
        loaded = load_rig(rig)
        return identify(loaded, [read_drag(loaded, f) for f in files])


def wanted(case: Case) -> set[str]:
    """Terms that a case has.

    Args:
        case: The case.
    """
    has = {
        "constant": case.constant_n > 0.0,
        "pressure": case.per_bar_n > 0.0,
        "viscous": case.film_n_s_m > 0.0,
        "breakaway": case.rise_n > 0.0,
    }
    return {name for name, there in has.items() if there}


def off(case: Case, found: Identified) -> dict[str, float]:
    """By how many standard errors strengths are off, of terms that are linear.

    Args:
        case: The case.
        found: What was found.
    """
    e = found.best
    true = {
        "constant": case.constant_n,
        "pressure": 2e-5 * case.per_bar_n,  # the simulator takes the mean of both sides
        "viscous": case.film_n_s_m,
    }
    return {
        t: (e.strength[t] - true[t]) / max(e.std_error[t], 1e-12)
        for t in e.law
        if t in true and "breakaway" not in e.law
    }


def main() -> None:
    """Draws, identifies and prints."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--each", type=int, default=10, help="cases of each kind")
    parser.add_argument("--first", type=int, default=0, help="first seed")
    chosen = parser.parse_args()
    table: dict[str, Counter[str]] = {}
    pulls: list[float] = []
    right = total = 0
    for kind in KINDS:
        table[kind] = Counter()
        for seed in range(chosen.first, chosen.first + chosen.each):
            case = draw_case(kind, seed)
            found = run(case)
            named = "+".join(found.best.law) or "none"
            alike = ["+".join(e.law) for e in found.alike]
            ok = set(found.best.law) == wanted(case)
            firm = (
                set(common_terms(found.best, found.alike)) if found.alike else set(found.best.law)
            )
            table[kind][f"{named}{' (or ' + ', '.join(alike) + ')' if alike else ''}"] += 1
            right += ok
            total += 1
            deviations = off(case, found) if ok else {}
            pulls += deviations.values()
            print(
                f"{'right' if ok else 'WRONG'} {kind} {seed} {case.course} at {case.gauge_bar} bar:"
                f" {found.verdict}, {named}, firm {sorted(firm)}, alike {alike},"
                f" truth {sorted(wanted(case))}, off by"
                f" { {t: round(d, 1) for t, d in deviations.items()} },"
                f" {found.explained:.3f} explained, {found.times_noise:.1f} times noise",
                flush=True,
            )
    for kind, named in table.items():
        print(f"{kind}: " + "; ".join(f"{n} x {name}" for name, n in named.most_common()))
    print(f"{right} of {total} right")
    pull = np.array(pulls)
    print(
        f"strengths off by {np.sqrt(np.mean(pull**2)):.2f} standard errors rms,"
        f" {np.abs(pull).max():.1f} at most ({pull.size} strengths)"
    )


if __name__ == "__main__":
    main()
