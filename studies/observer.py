# SPDX-License-Identifier: Apache-2.0
"""What an observer sees of labelled recordings: a tap it was never shown, faults, a wrong model.

Takes a folder of bags of the two rigs that ``rigs/`` has calibrations of, named as in
``docs/bags.md``: ``a_`` and ``b_``, ``healthy`` where nothing is hidden.
"""

import argparse
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from pneu_common.files import write_whole
from pneu_common.progress import progress
from pneu_sim.gas import AIR
from pneu_sim.observe.observer import Observer
from pneu_sim.observe.settings import Drift, ObserverSettings
from pneu_sim.plant import Plant, State
from pneu_sim.rig.load import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.observed.follow import Followed, evenly, follow
from pneu_sysid.records.read import read_recording
from pneu_sysid.records.recording import Recording
from studies.digest import digest_of
from studies.tap_faults import FAULTS, Fault

Floats = NDArray[np.float64]

ROOT = Path(__file__).resolve().parent.parent
RIGS = {"a": ROOT / "rigs" / "rig_a_fitted.yaml", "b": ROOT / "rigs" / "rig_b_fitted.yaml"}
USED = ("valve_out", "end")
SEEN = "middle"
DX_M = 0.1
NINETY = 1.645
"""Half width of a 90 % interval, in standard deviations."""
BEGIN_S = 1.0
LOST_S = (6.0, 8.0)
FAULTY_S = 5.0
PERIOD_S = 0.002
AHEAD_S, EVERY_S = 0.02, 0.1
"""Roll-outs begin so often, and are looked at so long after."""
LATER_S = 0.02
"""So much later readings still count, where it can be waited for them."""
QUANTUM_PA = 170.0
NOT_KNOWN = Drift(std=0.0, time_s=1.0)
BLIND = ObserverSettings(
    members=4,
    dx_m=DX_M,
    command=NOT_KNOWN,
    null=NOT_KNOWN,
    flow=NOT_KNOWN,
    supply=NOT_KNOWN,
    start_std_pa=1e-3,
    start_std_k=1e-6,
)
"""A simulation: members that do not differ."""


def read(rig: Rig, path: Path) -> Recording:
    """Reads a bag by a rig's channels.

    Args:
        rig: The rig.
        path: The bag.
    """
    return read_recording(
        path,
        commands={n: c.channel for n, c in rig.commands.items() if c.channel is not None},
        pressures={n: t.channel for n, t in rig.taps.items() if t.channel is not None},
    )


def rms(values: Floats) -> float:
    """Root mean square.

    Args:
        values: Any.
    """
    return float(np.sqrt(np.mean(values**2)))


def first_wrong(found: Followed) -> tuple[float, str]:
    """When it was first said that something is wrong, s, and what; infinite and nothing if never.

    Args:
        found: What an observer said.
    """
    for at, wrong, matter in zip(found.time_s, found.wrong, found.matter, strict=True):
        if wrong or matter:
            words = [*wrong, *(f"{tap}: {what}" for tap, what in matter.items())]
            return float(at), words[0]
    return math.inf, ""


def said_first(found: Followed) -> str:
    """Two cells of a row: when it was first said that something is wrong, and what.

    Args:
        found: What an observer said.
    """
    at, what = first_wrong(found)
    return "never | -" if math.isinf(at) else f"{at:.2f} s | {what}"


def healthy_rows(bag: Path, rig: Rig, noise_pa: float) -> tuple[list[str], str]:
    """Rows of the page about a recording in which nothing is hidden.

    Args:
        bag: The recording.
        rig: Its calibrated rig.
        noise_pa: Noise of its taps, with what their quantisation adds, Pa.
    """
    recording = read(rig, bag)
    s = ObserverSettings(dx_m=DX_M, noise_pa=noise_pa)
    found = follow(rig, recording, USED, s)
    later = follow(rig, recording, USED, s, steps_back=round(LATER_S / PERIOD_S))
    blind = follow(rig, recording, USED, BLIND, only_first=True)
    a, b = (rig.taps[name].position_m for name in USED)
    share = (rig.taps[SEEN].position_m - a) / (b - a)
    between = (1.0 - share) * found.read[USED[0]] + share * found.read[USED[1]]
    straight = (found.read[SEEN] - between)[found.time_s >= BEGIN_S]
    own = found.error(SEEN, BEGIN_S)
    row = (
        f"| {bag.name} | {rms(own):.0f} | {rms(own) / noise_pa:.2f} |"
        f" {100 * found.covered(SEEN, noise_pa, NINETY, BEGIN_S, math.inf):.0f} % |"
        f" {rms(later.error(SEEN, BEGIN_S)):.0f} |"
        f" {rms(straight[np.isfinite(straight)]):.0f} | {rms(blind.error(SEEN, BEGIN_S)):.0f} |"
    )
    rows = []
    whole = rms(found.error(SEEN, *LOST_S))
    for tap in USED:
        without = follow(rig, recording, USED, s, spoil=Fault(tap, *LOST_S))
        gone = rms(without.error(SEEN, *LOST_S))
        rows.append(
            f"| {bag.name} | {tap} | {whole:.0f} | {gone:.0f} | {gone / noise_pa:.2f} |"
            f" {rms(without.error(tap, *LOST_S)):.0f} |"
        )
    at, what = first_wrong(found)
    told = "nothing" if math.isinf(at) else f"after {at:.2f} s: {what}"
    return rows, f"{row} {told} |"


def start_row(bag: Path, rig: Rig, noise_pa: float) -> str:
    """A row of the page about roll-outs that begin in the middle of a recording.

    Args:
        bag: A recording in which nothing is hidden.
        rig: Its calibrated rig.
        noise_pa: Noise of its taps, Pa.
    """
    recording = read(rig, bag)
    time, volts, seen = evenly(recording, PERIOD_S)
    back = round(LATER_S / PERIOD_S)
    observer = Observer(rig, ObserverSettings(dx_m=DX_M, noise_pa=noise_pa), tuple(rig.taps), back)
    one = Plant([rig], DX_M)
    taps = list(one.plan.taps)
    ahead, every = round(AHEAD_S / PERIOD_S), round(EVERY_S / PERIOD_S)
    off: dict[str, list[Floats]] = {"straight": [], "observed": [], "later": []}
    waiting: dict[int, State] = {}

    def roll_out(way: str, state: State, n: int, now: Mapping[str, float] | None = None) -> None:
        one.set_state(state)
        if now is not None:
            lines_between(one, now)
        _, shown = one.advance(volts[None, :, n : n + ahead], PERIOD_S)
        measured = np.array([seen[tap][n + ahead] for tap in taps])
        off[way].append(shown[-1, : len(taps), 0] - measured)

    for n in range(time.size - ahead):
        now = {name: float(values[n]) for name, values in seen.items()}
        if n == 0:
            observer.begin(now)
        else:
            observer.advance(volts[:, n - 1 : n], PERIOD_S)
        observer.assimilate(now)
        if n - back in waiting:
            roll_out("later", observer.earlier_state(waiting.pop(n - back)), n - back)
        last = n + back >= time.size - ahead
        if time[n] < BEGIN_S or last or n % every or not np.isfinite(list(now.values())).all():
            continue
        waiting[n] = observer.mean_state()
        roll_out("straight", waiting[n], n, now)
        roll_out("observed", waiting[n], n)
    straight, observed, later = (np.array(off[way]) for way in off)
    fine = np.isfinite(straight).all(axis=1)
    return (
        f"| {bag.name} | {int(fine.sum())} | {rms(straight[fine]):.0f} |"
        f" {rms(observed[fine]):.0f} | {rms(later[fine]):.0f} |"
    )


def lines_between(plant: Plant, read: Mapping[str, float]) -> None:
    """Fills lines with gas at rest, its pressure on straight lines between the taps.

    Args:
        plant: One rig.
        read: By tap, Pa.
    """
    rig = plant.rigs[0]
    for pipe, (_, cells) in plant.plan.pipes.items():
        at = (np.arange(cells) + 0.5) * rig.pipes[pipe].length_m / cells
        known = sorted(
            (tap.position_m, read[name]) for name, tap in rig.taps.items() if tap.pipe == pipe
        )
        pressure = np.interp(at, *np.array(known).T)
        warm = AIR.r_specific * rig.ambient.temperature_k
        plant.set_gas(pipe, pressure / warm, 0.0, pressure)


def fault_rows(bag: Path, rig: Rig, noise_pa: float) -> list[str]:
    """Rows of the page about taps that fail.

    Args:
        bag: A recording in which nothing is hidden.
        rig: Its calibrated rig.
        noise_pa: Noise of its taps, Pa.
    """
    recording = read(rig, bag)
    s = ObserverSettings(dx_m=DX_M, noise_pa=noise_pa)
    rows = []
    for words, make in FAULTS.items():
        for tap in (*USED, SEEN):
            used = (*USED, SEEN)
            found = follow(rig, recording, used, s, spoil=make(tap, FAULTY_S))
            named = [
                (t, m[tap])
                for t, m in zip(found.time_s, found.matter, strict=True)
                if t >= FAULTY_S and tap in m
            ]
            others = {
                other
                for t, m in zip(found.time_s, found.matter, strict=True)
                if t >= FAULTY_S
                for other in m
            } - {tap}
            after = f"{1e3 * (named[0][0] - FAULTY_S):.0f} ms" if named else "never"
            last = named[-1][1] if named else "-"
            # what the tap truly would have shown: the recording, not what was done to it
            error = rms(found.error(tap, FAULTY_S + 0.5))
            rows.append(
                f"| {bag.name} | {tap} {words} | {after} | {last} |"
                f" {', '.join(sorted(others)) or 'none'} | {error:.0f} |"
            )
    return rows


def main() -> int:
    """Runs the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("bags", type=Path, help="folder of the bags")
    parser.add_argument("--page", type=Path, default=ROOT / "docs" / "observer.md")
    asked = parser.parse_args()
    bags = sorted(path for path in asked.bags.iterdir() if path.is_dir())
    noise_pa = math.hypot(250.0, QUANTUM_PA / math.sqrt(12.0))
    rigs = {key: load_rig(path) for key, path in RIGS.items()}
    seen, gone, starts, wrong, faults = [], [], [], [], []
    with progress("observer") as told:
        for n, bag in enumerate(bags):
            told(bag.name, n / len(bags))
            rig = rigs[bag.name[0]]
            if "healthy" in bag.name:
                rows, row = healthy_rows(bag, rig, noise_pa)
                seen.append(row)
                gone += rows
                starts.append(start_row(bag, rig, noise_pa))
                if bag.name == "a_healthy_2":
                    faults += fault_rows(bag, rig, noise_pa)
                continue
            s = ObserverSettings(dx_m=DX_M, noise_pa=noise_pa)
            found = follow(rig, read(rig, bag), USED, s)
            every = follow(rig, read(rig, bag), list(rig.taps), s)
            wrong.append(
                f"| {bag.name} | {said_first(found)} | {rms(found.error(SEEN, BEGIN_S)):.0f}"
                f" | {said_first(every)} |"
            )
    sources = digest_of([ROOT / "src/pneu_sim/pneu_sim", *RIGS.values(), *bags])
    write_whole(asked.page, "\n".join(page(sources, noise_pa, seen, gone, starts, wrong, faults)))
    Console().print(f"{asked.page} is written")
    return 0


def page(
    sources: str,
    noise_pa: float,
    seen: list[str],
    gone: list[str],
    starts: list[str],
    wrong: list[str],
    faults: list[str],
) -> list[str]:
    """The page.

    Args:
        sources: Digest of what it was made from.
        noise_pa: Noise of the taps, Pa.
        seen: Rows about the tap that was never shown.
        gone: Rows about taps that were lost.
        starts: Rows about roll-outs that begin in the middle.
        wrong: Rows about models that are wrong.
        faults: Rows about taps that fail.
    """
    return [
        "# An observer on labelled recordings",
        "",
        f"Made by `make observer BAGS=folder`, from the model, rigs and recordings {sources}.",
        "",
        f"The observer of `pneu_sim.observe`, 16 members in cells of {DX_M:g} m, takes the commands"
        f" and the taps {' and '.join(USED)} at 500 Hz. Errors are recorded less estimated, Pa,"
        f" from {BEGIN_S:g} s on; a recording's own noise is {noise_pa:.0f} Pa. No setting was"
        " fitted to these recordings but the thresholds of the last column, which were looked at"
        " on them.",
        "",
        "## A tap that it was never shown",
        "",
        f"| recording | {SEEN} | over the noise | within 90 % intervals | {1e3 * LATER_S:g} ms"
        " later | straight line between the taps | simulation from the first readings | said of"
        " the model |",
        "|---|---|---|---|---|---|---|---|",
        *seen,
        "",
        f"## A tap lost from {LOST_S[0]:g} to {LOST_S[1]:g} s",
        "",
        f"| recording | lost | {SEEN} with both | {SEEN} without | over the noise | the lost one |",
        "|---|---|---|---|---|---|",
        *gone,
        "",
        "## Roll-outs that begin in the middle",
        "",
        f"From {BEGIN_S:g} s on every {1e3 * EVERY_S:g} ms: all taps {1e3 * AHEAD_S:g} ms after"
        " the beginning, from gas at rest on straight lines between the readings of then, and from"
        " the mean of the members; last by all that was read in the"
        f" {1e3 * LATER_S:g} ms after the beginning too (a smoother). Pa.",
        "",
        "| recording | roll-outs | from straight lines | from the observer | from the smoother |",
        "|---|---|---|---|---|",
        *starts,
        "",
        "## A tap that fails",
        "",
        f"At {FAULTY_S:g} s, with all three taps of the tube.",
        "",
        "| recording | fault | left out after | named | others left out | error of its virtual"
        " tap |",
        "|---|---|---|---|---|---|",
        *faults,
        "",
        "## A model that is wrong",
        "",
        f"By the two taps, and by all, that of the supply among them; {SEEN} by the two, Pa.",
        "",
        f"| recording | first said after | what | {SEEN} | with all taps | what |",
        "|---|---|---|---|---|---|",
        *wrong,
        "",
    ]


if __name__ == "__main__":
    raise SystemExit(main())
