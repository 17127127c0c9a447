# SPDX-License-Identifier: Apache-2.0
"""The same answers as before: what many rigs do, kept by one version and compared with by another.

    python -m studies.golden keep FILE [FOLDER ...]       before a change
    python -m studies.golden compare FILE [FOLDER ...]    after it

Rigs are those of the repository and the rig files of further folders, as they are, with every
effect attached, and with every scheme; each is simulated along random commands, rigs that have taps
also along readings that correct the gas. What differs is listed, largest difference first, relative
to the largest magnitude of its signal; the exit status is 1 where one differs by more than 1e-12.
"""

import argparse
import itertools
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from pneu_sim.effects import registry
from pneu_sim.models import kind_of
from pneu_sim.rig import Rig, load_rig
from pneu_sim.rig.build import build
from pneu_sim.rig.plan import plan_grid
from pneu_sim.rig.schema import AttachedEffect
from pneu_sim.run import run_rig
from pneu_sim.signals import Signal
from pneu_sim.simulate import Course, InitialField, RunOptions, predict, rest
from pneu_sim.simulator import Simulator

Floats = NDArray[np.float64]

ROOT = Path(__file__).parent.parent
SECONDS, SAMPLE_S = 0.25, 0.002
MOST = 1e-12
"""Largest relative difference that rounding may bring about."""
SCHEMES = [
    dict(zip(("order", "flux", "limiter", "memory"), values, strict=True))
    for values in itertools.product(
        (1, 2), ("hllc", "exact"), ("minmod", "van_leer"), (True, False)
    )
]
WITH_EFFECTS = ("rig_a", "rig_b", "ventilator", "closed_chamber")
"""Rigs of the repository that are run with every effect; those of further folders are, too."""


def commands(rig: Rig, seed: int) -> dict[str, Floats]:
    """Random steps of every command, over the range in which its valve moves."""
    rng = np.random.default_rng(seed)
    count = round(SECONDS / SAMPLE_S) + 1
    found = {}
    for valve in rig.valves.values():
        curves = [p.opening.voltage_v for p in valve.ports.values() if p.opening.mirror is None]
        low, high = min(c[0] for c in curves), max(c[-1] for c in curves)
        steps = rng.uniform(low, high, 6)
        found.setdefault(valve.command, np.repeat(steps, -(-count // 6))[:count])
    return found


def variants(name: str, rig: Rig, all_effects: bool) -> Iterator[tuple[str, Rig]]:
    """A rig as it is, with every scheme, and with every effect where it can sit."""
    yield name, rig
    if not kind_of(rig).along_lines:
        return
    for scheme in SCHEMES:
        grid = rig.grid.model_copy(update=scheme)
        words = " ".join(str(value) for value in scheme.values())
        yield f"{name} [{words}]", rig.model_copy(update={"grid": grid})
    for field in ("thesis_ends", "thesis_joints"):
        grid = rig.grid.model_copy(update={field: True})
        yield f"{name} [{field}]", rig.model_copy(update={"grid": grid})
    if not all_effects:
        return
    for effect in registry().values():
        sites = list(effect.sites(rig, spacing_m=1.0))
        for place, shape in sites[len(sites) // 2 :][:1]:
            values = {effect.strength.name: effect.strength.typical, **shape}
            attached = AttachedEffect(effect=effect.name, place=place, parameters=values)
            yield (
                f"{name} + {effect.name}@{place}",
                rig.model_copy(update={"effects": [*rig.effects, attached]}),
            )


def answers(rig: Rig) -> dict[str, Floats]:
    """What a rig does: along commands, and along readings by which its gas is corrected."""
    volts = commands(rig, seed=7)
    if not kind_of(rig).along_lines:
        return dict(run_rig(rig, volts, SAMPLE_S)) if volts else {}
    simulator = Simulator(rig)
    out: dict[str, Floats] = {}
    # a rig without valves moves only by what is left in it
    full = {name: 3.0 * rig.ambient.pressure_pa for name in [*rig.pipes, *rig.chambers][:1]}
    simulator.reset(full)
    seen = simulator.run(SECONDS, volts, SAMPLE_S)
    for kind in ("taps", "pressures", "flows", "chambers"):
        out |= {f"{kind} {name}": series for name, series in getattr(seen, kind).items()}
    if rig.taps:
        plan = plan_grid(rig)
        time = np.sort(np.random.default_rng(3).uniform(0.0, SECONDS, (len(rig.taps), 60)), axis=1)
        time[:, 0] = 0.0
        at = np.arange(next(iter(seen.taps.values())).size) * SAMPLE_S
        read = np.array([np.interp(time[t], at, seen.taps[n]) for t, n in enumerate(rig.taps)])
        course = Course(
            {name: Signal(at[: series.size], series) for name, series in volts.items()},
            0.0,
            SECONDS,
            time,
            1.01 * read,
            np.full_like(read, 0.1),
            rest(rig, plan),
        )
        even = np.full((plan.slots, len(rig.taps)), 1.0 / len(rig.taps))
        spread = InitialField(
            even, even[:, 0] * 0.0, even[: len(plan.chambers)], np.zeros(len(plan.chambers))
        )
        found = predict([[build(rig, plan)]], [course], spread, None, RunOptions(1, strict=False))
        out["along readings"] = found[0].readings
    return out


def cases(folders: list[Path]) -> dict[str, Rig]:
    """All rigs and variants, by name."""
    found: dict[str, Rig] = {}
    for folder in [ROOT / "rigs", ROOT / "rigs" / "plants", *folders]:
        for path in sorted(folder.glob("*.yaml")):
            whole = path.stem in WITH_EFFECTS or folder in folders
            found |= dict(variants(path.stem, load_rig(path), whole))
    return found


def main() -> int:
    """Keeps or compares; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m studies.golden")
    parser.add_argument("what", choices=("keep", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("folders", type=Path, nargs="*")
    given = parser.parse_args()
    console = Console()
    now = {
        f"{name}: {signal}": series
        for name, rig in track(cases(given.folders).items(), "rigs", console=console)
        for signal, series in answers(rig).items()
    }
    if given.what == "keep":
        np.savez_compressed(given.file, **now)
        console.print(f"{len(now)} signals kept in {given.file}")
        return 0
    with np.load(given.file) as kept:
        before = {name: kept[name] for name in kept.files}
    console.print(f"{len(before)} signals before, {len(now)} now")
    differ = []
    for name in before.keys() | now.keys():
        if name not in before or name not in now or before[name].shape != now[name].shape:
            differ.append((np.inf, name))
            continue
        a, b = before[name], now[name]
        same = (a == b) | (np.isnan(a) & np.isnan(b))
        scale = np.max(np.abs(a[np.isfinite(a)]), initial=1e-300)
        most = np.max(np.where(same, 0.0, np.abs(a - b) / scale), initial=0.0)
        differ.append((np.inf if np.isnan(most) else float(most), name))
    differ.sort(reverse=True)
    equal = sum(most == 0.0 for most, _ in differ)
    beyond = sum(most > MOST for most, _ in differ)
    console.print(f"{equal} the same bit for bit, {beyond} differ by more than {MOST:g}")
    for most, name in differ[:20]:
        if most > 0.0:
            console.print(f"  {most:.2g}  {name}", highlight=False, markup=False)
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main())
