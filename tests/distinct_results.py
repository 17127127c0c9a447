# SPDX-License-Identifier: Apache-2.0
"""Results of commands made of numbers that all differ, to compare tables and pages with.

The numbers have signs and lie below and above one, so that a swapped pair, a lost sign, an inverted
ratio or a wrong unit shows. Nothing is simulated.
"""

import math
from typing import Any

import numpy as np

from pneu_sysid.results.compare import CompareResult
from pneu_sysid.results.diagnose import DiagnoseResult
from pneu_sysid.results.fit import FitResult
from pneu_sysid.results.learn import LearnResult

TAPS = ("supply", "valve_out", "end")
ENCODERS = {"elbow": "rad", "slide": "m"}
TYPICAL = {"Pa": 1500.0, "rad": 2e-3, "m": 3e-3}
MODELS = ("pde", "thin plate")


class Distinct:
    """Draws numbers that differ from all others drawn, in the third digit at least."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng(4)
        self.given: set[str] = set()

    def __call__(self, typical: float, signed: bool = False) -> float:
        """Return a number within a factor of ten of a typical one."""
        while True:
            value = typical * 10.0 ** self.rng.uniform(-1.0, 1.0)
            if (key := f"{value:.1e}") not in self.given:
                self.given.add(key)
                return float(value * (self.rng.choice([-1.0, 1.0]) if signed else 1.0))

    def share(self) -> float:
        """Return a fraction between 0.01 and 1."""
        return float(self.rng.uniform(0.01, 0.99))


def units_of(mixed: bool) -> dict[str, str]:
    return dict.fromkeys(TAPS, "Pa") | (ENCODERS if mixed else {})


def head(mixed: bool) -> dict[str, Any]:
    draw = Distinct()
    floors = {name: draw(0.2 * TYPICAL[unit]) for name, unit in units_of(mixed).items()}
    return {
        "pneu_version": "1", "recording": "run 3",
        "recordings": ["run 3", "run 4"], "rigs": ["rig"],
        "taps": list(TAPS), "encoders": ENCODERS if mixed else {},
        "noise_floor_pa": {n: f for n, f in floors.items() if n in TAPS},
        "noise_floor": {n: f for n, f in floors.items() if n not in TAPS},
    }  # fmt: skip


def split(mixed: bool, draw: Distinct, key: str) -> dict[str, dict[str, float]]:
    """Errors of all sensors under the keys of taps and of encoders."""
    values = {name: draw(TYPICAL[unit]) for name, unit in units_of(mixed).items()}
    return {
        f"{key}_pa": {n: v for n, v in values.items() if n in TAPS},
        key: {n: v for n, v in values.items() if n not in TAPS},
    }


def compare_result(mixed: bool) -> CompareResult:
    draw = Distinct()
    sensors = units_of(mixed)
    top = head(mixed)
    floors = top["noise_floor_pa"] | top["noise_floor"]

    def error(name: str) -> dict[str, Any]:
        unit = sensors[name]
        p = "_pa" if unit == "Pa" else ""
        worst = []
        for k in range(2):
            begin = draw(5.0)
            worst.append(
                {
                    f"rmse{p}": draw(TYPICAL[unit]), "start_s": begin, "end_s": begin + draw(1.0),
                    "recording": f"run {3 + k}", "doing": f"{name} was filled {k}",
                }
            )  # fmt: skip
        return {
            f"rmse{p}": draw(TYPICAL[unit]), "normalised": draw.share(), "times_noise": draw(5.0),
            f"bias{p}": draw(TYPICAL[unit], signed=True), "lag_s": draw(0.01, signed=True),
            "gain": draw(1.0), f"noise_floor{p}": floors[name], "worst": worst,
            **({"rmse_atm": draw(0.1)} if p else {"unit": unit}),
        }  # fmt: skip

    def regimes(names: tuple[str, ...], of: str, p: str) -> list[dict[str, Any]]:
        return [
            {
                "kind": kind, "label": label, "lower": low, "upper": high, of: name,
                f"rmse{p}": draw(5.0 * floors[name]), f"bias{p}": bias, "share": draw.share(),
                "samples": int(draw(300.0)), "times_noise": draw(5.0),
            }
            for kind, label, low, high in (
                ("pressure", "2-3 bar", 2e5, 3e5), ("pressure", "1-2 bar", 1e5, 2e5),
                ("frequency", "below 2 Hz", None, 2.0), ("flow_direction", "filling", None, None),
            )
            for name in names
            for bias in [None if kind == "frequency" else draw(5.0 * floors[name], signed=True)]
        ]  # fmt: skip

    models = [
        {
            "name": name, "model": "thin_plate" if k else "pde", "file": f"{name}.yaml",
            "taps": {n: error(n) for n in TAPS},
            "encoders": {n: error(n) for n in sensors if n not in TAPS},
            "regimes": regimes(TAPS, "tap", "_pa"),
            "encoder_regimes": regimes(tuple(ENCODERS), "encoder", "") if mixed else [],
            "rmse_pa": draw(1500.0), "times_noise": draw(5.0),
            "by_recording": {"run 3": draw(5.0), "run 4": draw(5.0)},
        }
        for k, name in enumerate(MODELS)
    ]  # fmt: skip
    # some readings are just where a cell of the map over time begins
    time_s = np.array([*(k + part for k in range(90) for part in (0.0, 0.75)), 90.0])
    signals: dict[str, dict[str, list[float | None]]] = {}
    for name, unit in sensors.items():
        own = {"measured": draw.rng.normal(0.0, 10.0 * TYPICAL[unit], time_s.size)}
        for model in MODELS:
            off = floors[name] * 10.0 ** draw.rng.uniform(-0.5, 2.2, time_s.size)
            own[model] = own["measured"] - off
        own["measured"][40:44] = np.nan
        signals[name] = {
            k: [None if math.isnan(x) else float(x) for x in v] for k, v in own.items()
        }
    taps, encoders = TAPS, [n for n in sensors if n not in TAPS]
    change = split(mixed, draw, "change")
    return CompareResult(
        **top,
        models=models,
        numerics={
            "dx_m": draw(0.05), "refined_dx_m": draw(0.02), "discretisation": False,
            "sentence": "The grid is fine.", **change,
        },
        series={
            "time_s": time_s.tolist(),
            "command": {"v1": draw.rng.normal(5.0, 2.0, time_s.size).tolist(),
                        "v2": draw.rng.normal(5.0, 2.0, time_s.size).tolist()},
            "measured": {n: signals[n]["measured"] for n in taps},
            "measured_encoders": {n: signals[n]["measured"] for n in encoders},
            "model": {m: {n: signals[n][m] for n in taps} for m in MODELS},
            "model_encoders": {m: {n: signals[n][m] for n in encoders} for m in MODELS},
            "gap_s": {n: draw(0.01) for n in sensors},
            "segments": [(0.0, 30.0), (31.5, 90.0)],
        },
    )  # fmt: skip


def fit_result(mixed: bool) -> FitResult:
    draw = Distinct()
    kinds = [
        ("pipes.tube.area_m2", 1e-5, "m^2, effective", {}),
        ("valves.valve.supply.conductance_m3_s_pa", 1e-8, "m^3/(s Pa)", {"at_bound": True}),
        ("sensors.end.delay_s", 0.02, "s", {"identified": False, "std_error": None}),
        ("joints.elbow.start", -1.0, "1", {"held": True, "identified": False}),
        ("pipes.tube.gain", 3.0, None, {}),
    ]
    parameters = []
    for path, typical, unit, marks in kinds:
        size, sign = abs(typical), math.copysign(1.0, typical)
        value = sign * draw(size)
        start = value * (0.7 if len(parameters) % 2 else 1.6)
        low, high = sorted((value, start))
        parameters.append(
            {
                "path": path, "value": value, "start": start, "unit": unit,
                "std_error": 0.3 * draw.share() * abs(value), "lower": low - draw(size),
                "upper": high + draw(size), "at_bound": False, "identified": True,
                "expected_error": draw(size), "expected_range": [draw(size), draw(size)],
            } | marks
        )  # fmt: skip
    paths = [p["path"] for p in parameters]
    return FitResult(
        **head(mixed),
        rig="rig.yaml",
        output="out.yaml",
        parameters=parameters,
        correlations=[
            {"a": paths[2], "b": paths[0], "value": -0.913},
            {"a": paths[1], "b": paths[2], "value": 0.957},
            {"a": paths[4], "b": paths[1], "value": -0.9942},
        ],
        condition=draw(1e4),
        warnings=["first warning", "second warning"],
        **split(mixed, draw, "rmse"),
        **split(mixed, draw, "held_out_rmse"),
        history=[draw(100.0), draw(50.0), draw(10.0), draw(4.0)],
    )


def diagnose_result(mixed: bool) -> DiagnoseResult:
    draw = Distinct()
    kinds = [
        ("leak", "m^2, effective", 1e-8, 0.3), ("sensor_lag", "s", 0.02, -0.09),
        ("sensor_gain", "1", -0.5, 0.7), ("valve_delay", "s", 0.6, -0.5),
    ]  # fmt: skip
    candidates = [
        {
            "effect": name, "title": f"title of {name}", "place": f"place_{k}",
            "position_m": draw(2.0) if k == 0 else None, "strength": draw(abs(size)) *
            math.copysign(1.0, size), "unit": unit, "std_error": 0.2 * draw.share() * abs(size),
            "explained_fraction": draw.share(), "refit_fraction": draw.share(),
            "held_out_gain": gain, "significance": draw(8.0), "tested": True,
            "indistinguishable_from": [f"other_{k}@there"] if k != 1 else [],
            "next_experiment": f"Experiment {k}." if k != 2 else "",
        }
        for k, (name, unit, size, gain) in enumerate(kinds)
    ]  # fmt: skip
    untested = {
        "effect": "drag", "title": "t", "place": "tube", "strength": 1.0, "unit": "1",
        "std_error": 1.0, "explained_fraction": 0.1, "tested": False,
    }  # fmt: skip
    return DiagnoseResult(
        **head(mixed),
        verdict="effect",
        sentence="Missing: a leak.",
        statements=["Something changed.", "The model leaves much."],
        **split(mixed, draw, "rmse"),
        candidates=[*candidates, untested],
        depends_on=[
            {"variable": "opening", "tap": "end", "gain": 0.231},
            {"variable": "pressure", "tap": "supply", "gain": 0.647},
        ],
        numerics={"dx_m": None, "refined_dx_m": None, "change_pa": {}, "discretisation": False,
                  "sentence": "None."},
    )  # fmt: skip


def learn_result(mixed: bool) -> LearnResult:
    draw = Distinct()
    steps = []
    kinds = [(None, None, None), ("leak", "m^2, effective", 1e-8), ("lag", "s", -0.02)]
    for k, (added, unit, size) in enumerate(kinds):
        more = {} if size is None else {
            "place": f"place_{k}", "unit": unit, "strength": size * draw(1.0),
            "std_error": 0.1 * abs(size),
        }  # fmt: skip
        # the training error rises at the second step, the held-out error at the third
        steps.append(
            {
                "step": k, "added": added, **more, **split(mixed, draw, "rmse"),
                **split(mixed, draw, "held_out_rmse"),
                "total_times_noise": (6.1, 8.3, 0.93)[k],
                "held_out_times_noise": (13.7, 3.4, 5.2)[k],
            }
        )  # fmt: skip
    pairs = [
        {"one": f"one_{k}", "other": f"other_{k}", "expected": e, "found": f, "needed": n}
        for k, (e, f, n) in enumerate([(5.82, -1.37, 3.0), (0.74, 2.61, 4.5), (1.9, None, 3.3)])
    ]
    return LearnResult(
        **head(mixed),
        steps=steps,
        verdict="effect",
        sentence="Added.",
        output="out",
        experiments=[
            {"plan": "a/first.json", "kind": "separate", "seconds": 12.5, "told_apart": pairs[:2]},
            {"plan": "a/second.json", "kind": "steps", "seconds": 7.25, "told_apart": []},
            {"plan": "a/third.json", "kind": "separate", "seconds": 31.0, "told_apart": pairs[2:]},
        ],
    )


BUILD = {
    "compare": compare_result,
    "fit": fit_result,
    "diagnose": diagnose_result,
    "learn": learn_result,
}
"""What makes the result of each command; with encoders or of taps alone."""
