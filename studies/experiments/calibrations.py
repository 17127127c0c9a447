# SPDX-License-Identifier: Apache-2.0
"""Calibrations: errors of fits to designed and to random recordings, and what plans promised."""

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from pneu_sim.rig import load_rig
from pneu_sim.rig.opening import opening_at
from pneu_sim.rig.schema import Rig
from pneu_sysid.curves import curve_ties
from pneu_sysid.design.design import Asked, design, promise_of
from pneu_sysid.design.limits import limits_of
from pneu_sysid.design.parameters import parameters_to_learn
from pneu_sysid.design.waves import STEP_S
from pneu_sysid.fit import fit_rig
from pneu_sysid.observed.noise import with_noise
from pneu_sysid.parameters import estimated_parameters, rig_at, variables_of
from studies.calibration import NINETY
from studies.experiments.plants import RATE_HZ, ROOT, Volts, plant_of, random_volts, record

Floats = NDArray[np.float64]

CALIBRATED = {"rigs/lab.yaml": 3, "rigs/rig_b.yaml": 6, "rigs/rig_j.yaml": 3}
"""Rigs, and how many datasheets are drawn of each: where three leave to chance which recording errs
less, more."""
LONG_S, SHORT_S = 10.0, 5.0
OFF = 0.5
"""By this share of the standard deviation that is not known numbers of a datasheet are off."""
NOISE_PA = 250.0
ENCODER = {"noise": 1e-4, "quantum": 3.8e-4}
"""Of taps and encoders (14 bits, rad) of which the rig file says nothing: no sensor is without."""
WAYS = (f"random {LONG_S:g} s", f"random {SHORT_S:g} s", f"designed {SHORT_S:g} s")


def datasheet(rig: Rig, seed: int) -> Rig:
    """A rig as its datasheet might have it: every number off by about what is not known of it.

    Opening curves are off as a whole: they bend no more there than a fit expects curves to.
    """
    bare = uncalibrated(rig)
    listed, _ = estimated_parameters(bare)
    rng = np.random.default_rng([seed, 47])
    variables = variables_of(bare, listed)
    std = np.array([v.known_std for v in variables])
    ties = curve_ties(bare, listed).matrix * std
    root = np.linalg.cholesky(np.eye(std.size) + ties.T @ ties)
    off = OFF * std * np.linalg.solve(root.T, rng.normal(size=std.size))
    x = [float(np.clip(v.value + o, v.lower, v.upper)) for v, o in zip(variables, off, strict=True)]
    return rig_at(bare, listed, np.array(x))


def uncalibrated(rig: Rig) -> Rig:
    """A rig of which is known what a fit takes to be known of its kind, and no more."""
    fit = rig.fit.model_copy(update={"parameters": []})
    return rig.model_copy(update={"calibration": None, "fit": fit})


def with_encoders(rig: Rig) -> Rig:
    """A rig all of whose encoders have noise and counts."""
    encoders = {
        name: one if one.noise or one.quantum else one.model_copy(update=ENCODER)
        for name, one in rig.encoders.items()
    }
    return rig.model_copy(update={"encoders": encoders})


def with_curves_of(rig: Rig, other: Rig) -> Rig:
    """A rig whose opening curves are told at the voltages of another's.

    A fit gives ports curves and points of their own, so that the same index is another voltage.
    """
    out = rig.model_copy(deep=True)
    for v, valve in out.valves.items():
        for p, port in valve.ports.items():
            known = other.valves[v].ports[p].opening
            if known.mirror is not None:
                port.opening = known
                continue
            volts = np.array(known.voltage_v)
            fraction = opening_at(port.opening, valve.spool.null_v, volts)
            port.opening = known.model_copy(update={"fraction": fraction.tolist()})
    return out


def told_of(rig: Rig, known: Rig, truth: Rig) -> tuple[Floats, float]:
    """What a fit tells of its own errors, but for opening curves, which have points of their own.

    Args:
        rig: Fitted rig.
        known: What was known before.
        truth: The rig that it was fitted to.

    Returns:
        (P,) standard errors, in what was not known before, which is also what is left of a number
        that was not shown; and the share of 90 % intervals that hold the truth.
    """
    listed = [p for p in estimated_parameters(known)[0] if ".opening." not in p.path]
    errors = {p.path: p.std_error for p in rig.fit.parameters}
    told, held = [], []
    for p, before, found, true in zip(
        listed, *(variables_of(r, listed) for r in (known, rig, truth)), strict=True
    ):
        error = errors.get(p.path)
        if not error:
            told.append(1.0)
            continue
        std = error / math.exp(found.value) if p.log else error
        told.append(min(std / before.known_std, 1.0))
        held.append(abs(found.value - true.value) < NINETY * std)
    return np.array(told), float(np.mean(held))


def ratios_of(rig: Rig, expected: Mapping[str, float | None]) -> list[float]:
    """Standard errors of a fit over those expected, but for opening curves: quantiles.

    Args:
        rig: Fitted rig.
        expected: By the path of each parameter.
    """
    found = {p.path: p.std_error for p in rig.fit.parameters}
    ratios = [
        error / foreseen
        for path, foreseen in expected.items()
        if (error := found.get(path)) and foreseen and ".opening." not in path
    ]
    return spread_of(np.array(ratios))


def spread_of(ratios: Floats) -> list[float]:
    """The middle of ratios, between the ends of the middle 80 %."""
    return [float(x) for x in np.quantile(ratios, [0.1, 0.5, 0.9])]


def calibration_figures(file: str, seed: int, console: Console) -> dict[str, Any]:
    """One datasheet: a fit to ten random seconds, to five, and to five that were designed."""
    true = load_rig(ROOT / file)
    true = with_encoders(with_noise(true, dict.fromkeys(true.taps, NOISE_PA)))
    sheet = datasheet(true, seed)
    limits = limits_of(sheet)
    plant = plant_of(true)
    listed, _ = estimated_parameters(sheet)
    variables = variables_of(sheet, listed)
    scale = np.array([v.known_std for v in variables])
    truth = np.array([v.value for v in variables_of(true, listed)])
    begun = time.monotonic()
    learnt = parameters_to_learn(sheet)
    plan = design(sheet, Asked(SHORT_S, limits, [], learnt, rate_hz=RATE_HZ, seed=seed))
    out: dict[str, Any] = {"design_s": time.monotonic() - begun, "parameters": len(listed)}
    volts: list[Volts] = [
        random_volts(sheet, limits, LONG_S, 10 * seed + 1),
        random_volts(sheet, limits, SHORT_S, 10 * seed + 2),
        plan.volts(STEP_S),
    ]
    told: dict[str, Floats] = {}
    for name, series in zip(WAYS, volts, strict=True):
        fitted = fit_rig(sheet, [record(plant, series, "recording", seed + 10)])
        found = variables_of(with_curves_of(fitted.rig, true), listed)
        off = np.abs(np.array([v.value for v in found]) - truth) / scale
        out[name] = [float(np.sqrt(np.mean(off**2))), float(np.median(off))]
        told[name], held = told_of(fitted.rig, sheet, true)
        out[name] += [float(np.sqrt(np.mean(told[name] ** 2))), held]
        console.print(f"{file}, datasheet {seed}: {name}: {out[name][0]:.3f} of what was unknown")
    long, _, designed = WAYS
    out["errors_over_random"] = spread_of(told[designed] / told[long])
    out["error_ratios"] = ratios_of(fitted.rig, plan.expected.std_errors)
    bare = uncalibrated(true)
    learnt = parameters_to_learn(bare)
    itself = promise_of(bare, Asked(SHORT_S, limits, [], learnt, rate_hz=RATE_HZ), volts[-1])
    names = [v.name for v in itself.told.variables]
    errors = dict(zip(names, itself.errors(learnt).tolist(), strict=True))
    out["error_ratios_itself"] = ratios_of(fitted.rig, errors)
    return out


def key_of(file: str, seed: int) -> str:
    """Name of what is kept of a datasheet."""
    return f"calibration_{Path(file).stem}_{seed}"
