# SPDX-License-Identifier: Apache-2.0
"""Which numbers of a rig are fitted when its file does not say: the list of thesis 8.1.1."""

import numpy as np

from pneu_sim.rig.parameters import get_parameter, value_of, with_parameters
from pneu_sim.rig.schema import CLOSED, FitParameter, Rig
from pneu_sysid.gauss_newton import Variable

SLOPE_CHANGE = 0.2
"""Expected change of an opening curve's slope between neighbouring intervals, of its mean slope."""

EXPONENT_CHANGE = 0.1
"""Expected change of a power-law curve's local exponent between neighbouring intervals."""

STEP_FRACTION = 2e-3
"""Difference step as a fraction of the range (of the value, for a logarithmic parameter)."""


def default_parameters(rig: Rig) -> list[FitParameter]:
    """Base parameters of a rig, with ranges a datasheet leaves open.

    Valve conductances, critical ratios, opening curves, spool dynamics; pipe areas, wall drag and
    heat, volumes at valves and closed ends; tap positions; reservoir pressures above the room's.
    A lumped model has its openings against voltage, full opening included, and the spool (thesis
    8.1.3): volumes, polytropic exponent and discharge factor only scale what the openings do.

    Args:
        rig: The rig.
    """
    out: list[FitParameter] = []

    def add(path: str, lower: float, upper: float, std: float, log: bool = False) -> None:
        out.append(FitParameter(path=path, lower=lower, upper=upper, std=std, log=log))

    def around(path: str, factor: float, relative_std: float) -> None:
        value = get_parameter(rig, path)
        add(path, value / factor, value * factor, value * relative_std, log=True)

    lumped = rig.model != "pde"
    for v, valve in rig.valves.items():
        if valve.spool.bandwidth_hz is not None:
            around(f"valves.{v}.spool.bandwidth_hz", 3.0, 0.3)
            add(f"valves.{v}.spool.damping", 0.3, 3.0, 0.4)
        if not lumped and all(port.model == "iso6358" for port in valve.ports.values()):
            # One block holds all ports; apart, a recording that seldom opens one tells little of it
            add(f"valves.{v}.ports.*.laminar_ratio", 0.85, 0.9995, 0.02)
            add(f"valves.{v}.ports.*.laminar_widening", 0.0, 4.0, 2.0)
            add(f"valves.{v}.ports.*.jet_loss", 0.0, 4.0, 0.1)
            add(f"valves.{v}.ports.*.inlet_head", 0.0, 2.0, 0.1)
        for p, port in valve.ports.items():
            base = f"valves.{v}.ports.{p}"
            size = "conductance_m3_s_pa" if port.model == "iso6358" else "area_m2"
            if lumped:
                around(f"{base}.{size}", 5.0, 1.0)
            elif port.model == "iso6358":
                around(f"{base}.conductance_m3_s_pa", 2.0, 0.3)
                add(f"{base}.critical_ratio", 0.02, 0.7, 0.1)
            else:
                around(f"{base}.area_m2", 3.0, 0.5)
            if not lumped:
                add(f"{base}.leakage", 0.0, 0.02, 0.002)
            curve = port.opening
            if curve.mirror is not None:
                continue
            last = len(curve.fraction) - 1
            for k, fraction in enumerate(curve.fraction):
                path = f"{base}.opening.fraction.{k}"
                if curve.interpolation == "power":
                    # the point furthest from null is the full opening the conductance is for
                    if k != (last if curve.voltage_v[-1] > valve.spool.null_v else 0):
                        around(path, 10.0, 0.7)
                elif 0 < k < last:
                    top = max(0.1, min(1.2, 3.0 * fraction))
                    add(path, 0.0, top, max(0.05, 0.5 * fraction))
    if lumped:
        return out
    valve_nodes = {
        node
        for valve in rig.valves.values()
        for port in valve.ports.values()
        for node in (port.from_node, port.to_node)
    }
    for name, pipe in rig.pipes.items():
        base = f"pipes.{name}"
        around(f"{base}.area_m2", 1.5, 0.03)
        add(f"{base}.wall.turbulent", 0.2, 4.0, 0.5)
        add(f"{base}.wall.nusselt", 0.0, 40.0, 8.0)
        for end, node in (("from", pipe.from_node), ("to", pipe.to_node)):
            if node not in rig.chambers and (node in valve_nodes or node == CLOSED):
                reach = pipe.area_m2 * min(pipe.length_m, 0.3)
                add(f"{base}.volume_{end}_m3", 0.0, 3.0 * reach, 0.3 * reach)
        for k in range(len(pipe.losses)):
            add(f"{base}.losses.{k}.k", 0.0, 5.0, 0.5)
            add(f"{base}.losses.{k}.resistance_pa_s_m", 0.0, 3000.0, 300.0)
    for name in rig.chambers:
        around(f"chambers.{name}.volume_m3", 4.0, 0.5)
    add("pipes.*.wall.laminar", 0.3, 3.0, 0.3)
    add("pipes.*.wall.unsteady", 0.0, 3.0, 0.5)
    add("pipes.*.wall.turbulent_fade", 0.0, 3.0, 0.5)
    add("pipes.*.wall.heat_unsteady", 0.0, 3.0, 0.5)
    add("pipes.*.wall.heat_turbulent", 0.0, 3.0, 0.5)
    add("pipes.*.wall.onset_reynolds", 1000.0, 20000.0, 1500.0, log=True)
    for name, tap in rig.taps.items():
        if tap.pipe is not None and tap.channel is not None:
            length = rig.pipes[tap.pipe].length_m
            reach = min(0.04, 0.2 * length)
            add(
                f"taps.{name}.position_m",
                max(0.0, tap.position_m - reach),
                min(length, tap.position_m + reach),
                0.01,
            )
    for name, reservoir in rig.reservoirs.items():
        if reservoir.pressure_pa > 1.05 * rig.ambient.pressure_pa:
            around(f"reservoirs.{name}.pressure_pa", 1.1, 0.02)
            add(f"reservoirs.{name}.inlet_loss", 0.0, 3.0, 0.5)
    return out


def variables_of(rig: Rig, parameters: list[FitParameter]) -> list[Variable]:
    """Variables of the estimation; logarithmic parameters are estimated as logarithms.

    Args:
        rig: The rig that holds the start values.
        parameters: What to estimate.
    """
    out = []
    for p in parameters:
        value = float(np.clip(value_of(rig, p), p.lower, p.upper))
        if p.log:
            out.append(
                Variable(
                    name=p.path,
                    value=float(np.log(value)),
                    lower=float(np.log(p.lower)),
                    upper=float(np.log(p.upper)),
                    step=STEP_FRACTION,
                    std=p.std / value if p.std is not None else np.inf,
                )
            )
        else:
            out.append(
                Variable(
                    name=p.path,
                    value=value,
                    lower=p.lower,
                    upper=p.upper,
                    step=STEP_FRACTION * (p.upper - p.lower),
                    std=p.std if p.std is not None else np.inf,
                )
            )
    return out


def rig_at(rig: Rig, parameters: list[FitParameter], x: np.ndarray) -> Rig:
    """The rig with its parameters at a point of the estimation.

    Args:
        rig: The rig.
        parameters: What is estimated.
        x: (P,) point; logarithms where the parameter is logarithmic.
    """
    shared: dict[str, float] = {}
    own: dict[str, dict[str, float]] = {name: dict(of) for name, of in rig.recordings.items()}
    for p, v in zip(parameters, x, strict=True):
        value = float(np.exp(v)) if p.log else float(v)
        if p.recording is None:
            shared[p.path] = value
        else:
            own.setdefault(p.recording, {})[p.path] = value
    for path in {path for of in own.values() for path in of} - set(shared):
        # a recording that nobody has fitted gets the mean of those that were
        shared[path] = float(np.mean([of[path] for of in own.values() if path in of]))
    out = with_parameters(rig, shared)
    return out.model_copy(update={"recordings": own}) if own else out


def one_each(parameters: list[FitParameter], recordings: list[str]) -> list[FitParameter]:
    """Parameters with those that have one value in each recording listed once for each.

    Args:
        parameters: As the rig lists them.
        recordings: Names of the recordings.
    """
    return [
        p.model_copy(update={"recording": name})
        for p in parameters
        for name in (recordings if p.each else [None])
    ]


def joined(fitted: list[FitParameter], listed: list[FitParameter]) -> list[FitParameter]:
    """Parameters as the rig lists them, with the standard errors that the fit found.

    Args:
        fitted: What was fitted, some of it once for each recording.
        listed: The rig's list.
    """
    out = []
    for p in listed:
        errors = [f.std_error for f in fitted if f.path == p.path and f.std_error is not None]
        out.append(p.model_copy(update={"std_error": max(errors) if errors else None}))
    return out


def curve_ties(rig: Rig, parameters: list[FitParameter]) -> tuple[np.ndarray, np.ndarray]:
    """Smoothness of the opening curves as prior relations between their points.

    The slope of a curve may change from one interval to the next by about ``SLOPE_CHANGE`` of its
    mean slope, so that a voltage the recording never dwelt on follows its neighbours.

    Args:
        rig: The rig.
        parameters: What is estimated.

    Returns:
        (K, P) matrix and (K,) right side for ``gauss_newton.minimise``.
    """
    index = {p.path: k for k, p in enumerate(parameters)}
    rows, sides = [], []
    for v, valve in rig.valves.items():
        for p, port in valve.ports.items():
            curve = port.opening
            if curve.mirror is not None:
                continue
            x, y = np.array(curve.voltage_v), np.array(curve.fraction)
            if curve.interpolation == "power":
                # in the logarithms a slope is the exponent of the local power law
                x, y = np.log(np.abs(x - valve.spool.null_v)), np.log(y)
                change = EXPONENT_CHANGE
            else:
                change = SLOPE_CHANGE / abs(x[np.argmax(y)] - valve.spool.null_v)
            base = f"valves.{v}.ports.{p}.opening.fraction"
            for k in range(1, x.size - 1):
                left, right = 1.0 / (x[k] - x[k - 1]), 1.0 / (x[k + 1] - x[k])
                weights = {k - 1: left, k: -left - right, k + 1: right}
                row, side = np.zeros(len(parameters)), 0.0
                for i, weight in weights.items():
                    at = index.get(f"{base}.{i}")
                    scaled = weight / change
                    if at is None:
                        side -= scaled * y[i]
                    else:
                        row[at] = scaled
                if row.any():
                    rows.append(row)
                    sides.append(side)
    return np.array(rows).reshape(-1, len(parameters)), np.array(sides)
