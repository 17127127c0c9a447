# SPDX-License-Identifier: Apache-2.0
"""Drag tests drawn at random, by equations of their own: nothing here comes from the packages.

A stiff machine moves a rod by a given course. The seal is an elastic lip that shears before it
slides (Dahl 1968); sliding, it holds with ``mu * width * (squeeze + share * pressure)``, a film's
shear ``eta * area / gap * speed``, and a rise at low speed of Lorentz's shape (not of Gauss's,
which the simulator has). Bore and stroke number change it by a few percent, recordings by one
percent. Sensors have noise, steps, wrong zeros and gains, outliers and gaps; the clock jitters.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

KINDS = ("none", "constant", "growing", "viscous", "stribeck")
LAYOUT = "time ms, position mm, pressure bar gauge, force N"


@dataclass(frozen=True)
class Case:
    """One cylinder and how it is dragged.

    Attributes:
        kind: What its friction is made of, of `KINDS`.
        bore_m: Bore.
        stroke_m: Stroke.
        constant_n: Sliding friction without pressure.
        per_bar_n: Growth per bar of chamber pressure, N.
        film_n_s_m: Film's shear per speed.
        rise_n: By how much more it holds when slow.
        rise_m_s: Speed at which half of that is left.
        gauge_bar: Pressure of each recording.
        speed_m_s: Fastest speed of each recording.
        course: ``triangle`` or ``sine``.
        cycles: To and fro, in each recording.
        noise_n: Noise of the force cell.
        slack_m: Over how much way the seal is sheared.
        texture: Relative change along the bore.
        run_in: Relative change over a recording.
        scatter: Relative scatter of recordings.
        seed: Of everything random.
    """

    kind: str
    bore_m: float
    stroke_m: float
    constant_n: float
    per_bar_n: float
    film_n_s_m: float
    rise_n: float
    rise_m_s: float
    gauge_bar: tuple[float, ...]
    speed_m_s: tuple[float, ...]
    course: str
    cycles: int
    noise_n: float
    slack_m: float
    texture: float
    run_in: float
    scatter: float
    seed: int
    files: list[Path] = field(default_factory=list)


def draw_case(kind: str, seed: int) -> Case:
    """Draws a cylinder with one kind of friction, and a test that can show it.

    Args:
        kind: One of `KINDS`.
        seed: Seed.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    bore = rng.uniform(0.012, 0.04)
    usual = rng.uniform(1.5, 12.0)
    count = int(rng.integers(2, 5))
    gauge = np.sort(rng.choice(np.arange(1.0, 8.0), count, replace=False))
    cycles = int(rng.integers(3, 10))
    top = rng.uniform(0.01, 0.04)
    course = str(rng.choice(["triangle", "sine"]))
    speeds = np.full(count, top)
    # Speeds have to differ for their terms to show; a sine has them all.
    if kind in ("viscous", "stribeck") and course == "triangle":
        each = np.geomspace(0.15, 1.0, max(count, 4)) * top
        gauge = np.full(each.size, gauge[0]) if rng.random() < 0.5 else rng.choice(gauge, each.size)
        speeds = each
    constant = 0.0 if kind in ("none", "viscous") and rng.random() < 0.5 else usual
    if kind == "none":
        constant = 0.0
    return Case(
        kind=kind,
        bore_m=float(bore),
        stroke_m=float(rng.uniform(0.03, 0.08)),
        constant_n=float(constant),
        per_bar_n=float(usual * rng.uniform(0.08, 0.3)) if kind == "growing" else 0.0,
        film_n_s_m=float(usual * rng.uniform(0.6, 1.5) / top) if kind == "viscous" else 0.0,
        rise_n=float(constant * rng.uniform(0.5, 1.0)) if kind == "stribeck" else 0.0,
        rise_m_s=float(top * rng.uniform(0.2, 0.35)),
        gauge_bar=tuple(float(g) for g in gauge),
        speed_m_s=tuple(float(s) for s in speeds),
        course=course,
        cycles=cycles,
        noise_n=float(rng.choice([0.02, 0.1, 0.3])),
        slack_m=float(rng.uniform(1e-4, 5e-4)),
        texture=float(rng.uniform(0.0, 0.04)),
        run_in=float(rng.uniform(-0.04, 0.04)),
        scatter=0.01,
        seed=seed,
    )


def _course(case: Case, speed: float, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Times and places of the rod, counted inwards, at 1 kHz."""
    way = 0.75 * case.stroke_m
    if case.course == "sine":
        period = np.pi * way / speed
        time = np.arange(0.0, case.cycles * period, 1e-3)
        return time, 0.5 * way * (1.0 - np.cos(2.0 * np.pi * time / period))
    back = speed * rng.uniform(0.75, 1.25)
    legs = np.tile([way / speed, way / back], case.cycles)
    ends = np.concatenate(([0.0], np.cumsum(legs)))
    time = np.arange(0.0, ends[-1], 1e-3)
    place = np.interp(time, ends, np.tile([0.0, way], case.cycles + 1)[: ends.size])
    soft = np.ones(60) / 60.0  # the machine turns within a few hundredths of a second
    place = np.convolve(
        np.concatenate((np.full(60, place[0]), place, np.full(60, place[-1]))), soft
    )
    return time, place[90 : 90 + time.size]


def record(case: Case, k: int) -> Floats:
    """(n, 4) rows of one recording, see `LAYOUT`.

    Args:
        case: The case.
        k: Which of its recordings.
    """
    rng = np.random.default_rng([case.seed, KINDS.index(case.kind), 77, k])
    shapes = np.random.default_rng([case.seed, KINDS.index(case.kind), 78])
    phase = shapes.uniform(0.0, 2.0 * np.pi, 3)
    time, place = _course(case, case.speed_m_s[k], rng)
    speed = np.gradient(place, time)
    share = place / (0.75 * case.stroke_m)
    area = np.pi * case.bore_m**2 / 4.0
    # The regulator lets pressure rise a little while the rod is pressed in.
    follow = np.convolve(speed, np.ones(400) / 400.0)[: speed.size]
    gauge = case.gauge_bar[k] * (1.0 + 0.01 * follow / max(case.speed_m_s[k], 1e-9))
    fast = np.abs(speed)
    hold = case.constant_n + case.per_bar_n * gauge
    hold += case.rise_n / (1.0 + (fast / case.rise_m_s) ** 2)
    waves = sum(np.sin(2.0 * np.pi * (n + 1) * share + phase[n]) for n in range(3)) / 3.0
    varied = 1.0 + case.texture * waves + case.run_in * (time / time[-1] - 0.5)
    varied *= 1.0 + case.scatter * rng.standard_normal()
    hold *= varied
    lip = np.empty(time.size)
    state = 0.0
    steps = np.diff(place, prepend=place[0])
    for i, (dx, most) in enumerate(zip(steps.tolist(), hold.tolist(), strict=True)):
        target = most if dx >= 0.0 else -most
        state = target + (state - target) * np.exp(-abs(dx) / case.slack_m)
        lip[i] = state
    gain, zero = shapes.normal(1.0, 0.008), shapes.normal(0.0, 2.0)
    force = zero + gain * area * gauge * 1e5 + lip + case.film_n_s_m * speed * varied
    pick = np.cumsum(rng.choice([10, 10, 10, 11, 12], time.size // 10))
    pick = pick[pick < time.size]
    pick = pick[rng.random(pick.size) > 0.01]
    hole = rng.integers(pick.size // 4, pick.size // 2)
    pick = np.delete(pick, slice(hole, hole + int(rng.integers(3, 30))))
    n = pick.size
    force = np.round((force[pick] + case.noise_n * rng.standard_normal(n)) / 0.015) * 0.015
    where = place[pick] + 1.5e-5 * rng.standard_normal(n)
    where += np.where(rng.random(n) < 0.002, rng.normal(0.0, 1e-3, n), 0.0)
    where = np.round(where / 4.4e-6) * 4.4e-6
    read = np.round((gauge[pick] + 0.002 * rng.standard_normal(n)) / 0.002) * 0.002
    return np.column_stack([time[pick] * 1e3, where * 1e3, read, force])


def rig_text(case: Case) -> str:
    """The rig file of a case; its bore is the drawing's, right to some promille.

    Args:
        case: The case.
    """
    return f"""\
pneu_rig: 1
name: drawn
cylinders:
  c:
    bore_m: {case.bore_m:.4f}
    stroke_m: {case.stroke_m:.3f}
    head: {{node: closed, dead_volume_m3: 1.0e-5}}
text: {{time: 0, time_scale: 1.0e-3, delimiter: "\\t"}}
drag:
  cylinder: c
  pressure: {{column: 2, scale: 1.0e+5, offset: 101325.0}}
  force: {{column: 3}}
  position: {{column: 1, scale: -1.0e-3}}
"""


def write_case(case: Case, folder: Path) -> tuple[Path, list[Path]]:
    """Writes rig file and recordings of a case.

    Args:
        case: The case.
        folder: Where; it must exist.

    Returns:
        The rig file and the recordings.
    """
    rig = folder / "rig.yaml"
    rig.write_text(rig_text(case), encoding="utf-8")
    files = []
    for k in range(len(case.gauge_bar)):
        path = folder / f"drag_{k}.csv"
        np.savetxt(path, record(case, k), fmt="%.3f", delimiter="\t", newline="\r\n")
        files.append(path)
    return rig, files
