# SPDX-License-Identifier: Apache-2.0
"""Which numbers of a rig are fitted when its file does not say: the list of thesis 8.1.1."""

from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.models import kind_of
from pneu_sim.rig.parameters import each_that_differs, get_parameter, value_of, with_parameters
from pneu_sim.rig.schema import CLOSED, FitParameter, Rig
from pneu_sysid.moving_parameters import moving_parameters
from pneu_sysid.slopes import Variable

STEP_FRACTION = 2e-3
"""Difference step as a fraction of the range (of the value, for a logarithmic parameter)."""
WELL_KNOWN, SHORT = 0.01, 0.01
"""What is known to better than such a fraction of its value has short steps, of such a part of
that. These are lengths of linkages: 2e-3 of them drives a piston 0.3 mm into a cover that yields
micrometres, and moves of two that leave it where it is no longer cancel."""


def default_parameters(rig: Rig) -> list[FitParameter]:
    """Base parameters of a rig, with ranges a datasheet leaves open.

    Valve conductances, critical ratios, opening curves, spool dynamics; pipe areas, wall drag and
    heat, volumes at valves and closed ends; tap positions; reservoir pressures above the room's.
    A lumped model has its openings against voltage, full opening included, and the spool (thesis
    8.1.3): volumes, polytropic exponent and discharge factor only scale what the openings do.
    What the ports of a valve, or all pipes, share is one number, unless the file has them differ.

    Args:
        rig: The rig.
    """
    out: list[FitParameter] = []

    def add(path: str, lower: float, upper: float, std: float, log: bool = False) -> None:
        for one in each_that_differs(rig, path):
            out.append(FitParameter(path=one, lower=lower, upper=upper, std=std, log=log))

    def around(path: str, factor: float, relative_std: float) -> None:
        value = get_parameter(rig, path)
        add(path, value / factor, value * factor, value * relative_std, log=True)

    lumped = not kind_of(rig).along_lines
    for v, valve in rig.valves.items():
        if valve.spool.bandwidth_hz is not None:
            around(f"valves.{v}.spool.bandwidth_hz", 3.0, 0.3)
            add(f"valves.{v}.spool.damping", 0.3, 3.0, 0.4)
        if not lumped and all(port.model == "iso6358" for port in valve.ports.values()):
            # One block holds all ports; apart, a recording that seldom opens one tells little of it
            add(f"valves.{v}.ports.*.laminar_ratio", 0.85, 0.9995, 0.02)
            add(f"valves.{v}.ports.*.laminar_widening", 0.0, 4.0, 2.0)
            add(f"valves.{v}.ports.*.laminar_share", 0.1, 1.0, 0.3)
            add(f"valves.{v}.ports.*.jet_loss", 0.0, 4.0, 0.25)
            add(f"valves.{v}.ports.*.inlet_head", 0.0, 2.0, 0.25)
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
    out += moving_parameters(rig)
    if rig.pipes:
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


def calibrated_parameters(rig: Rig) -> list[FitParameter]:
    """What a calibration fits where the rig's file does not list it: base parameters and more.

    Beside the `default_parameters` what real rigs have and no datasheet tells: the delays of a
    valve, limits of its spool where the rig has them, heat through the walls of chambers,
    restrictors, losses and volumes at junctions and fittings.

    Args:
        rig: The rig.
    """
    out = default_parameters(rig)
    if not kind_of(rig).along_lines:
        return out

    def add(path: str, lower: float, upper: float, std: float, log: bool = False) -> None:
        for one in each_that_differs(rig, path):
            out.append(FitParameter(path=one, lower=lower, upper=upper, std=std, log=log))

    def around(path: str, factor: float, relative_std: float) -> None:
        value = get_parameter(rig, path)
        if value > 0.0:
            add(path, value / factor, value * factor, value * relative_std, log=True)

    for v, valve in rig.valves.items():
        base = f"valves.{v}.spool"
        longest = max(0.02, 4.0 * valve.spool.delay_s)
        add(f"{base}.delay_s", 0.0, longest, 1.5e-3)
        if valve.spool.closing_delay_s is not None:
            add(f"{base}.closing_delay_s", 0.0, longest, 1.5e-3)
        if valve.spool.max_speed_v_s is not None:
            around(f"{base}.max_speed_v_s", 10.0, 1.0)
        if valve.spool.max_acceleration_v_s2 is not None:
            around(f"{base}.max_acceleration_v_s2", 10.0, 1.0)
    if rig.pipes:
        add("pipes.*.wall.roughness_m", 0.0, 5e-5, 5e-6)
    for name in rig.chambers:
        around(f"chambers.{name}.heat_w_per_k", 5.0, 0.4)
        around(f"chambers.{name}.convection_m2", 5.0, 0.4)
    for name in rig.orifices:
        around(f"orifices.{name}.conductance_m3_s_pa", 3.0, 0.3)
        add(f"orifices.{name}.critical_ratio", 0.02, 0.7, 0.1)
        add(f"orifices.{name}.laminar_ratio", 0.85, 0.9995, 0.02)
    vessels = {*rig.chambers, *(s.node for c in rig.cylinders.values() for s in c.sides.values())}
    met: dict[str, int] = {}
    for pipe in rig.pipes.values():
        for node in (pipe.from_node, pipe.to_node):
            met[node] = met.get(node, 0) + 1
    volumes: set[str] = set()
    listed = {p.path for p in out}
    for name, pipe in rig.pipes.items():
        for end, node in (("from", pipe.from_node), ("to", pipe.to_node)):
            if node == CLOSED or node in rig.reservoirs:
                continue
            joined = met[node] > 1 and node not in vessels
            if joined or node in vessels:
                add(f"pipes.{name}.loss_{end}", 0.0, 4.0, 0.3)
            path = f"pipes.{name}.volume_{end}_m3"
            if joined and node not in volumes and path not in listed:
                volumes.add(node)  # one of the ends that meet stands for all
                reach = pipe.area_m2 * min(pipe.length_m, 0.3)
                add(path, 0.0, 3.0 * reach, 0.1 * reach)
    return out


def listed_parameters(rig: Rig, base: list[FitParameter]) -> tuple[list[FitParameter], list[str]]:
    """What is fitted of a rig, after what its file adds, drops and holds.

    Args:
        rig: The rig.
        base: What is fitted where the file says nothing of it.

    Returns:
        The parameters, and the paths of those among them that are held: they keep their values.

    Raises:
        InputError: A pattern of ``fit.drop`` or ``fit.hold`` meets nothing.
    """
    added = {p.path: p for p in rig.fit.add}
    every = [added.pop(p.path, p) for p in base] + list(added.values())
    # a calibrated rig lists what was fitted, without what its patterns took out
    known = {p.path for p in every + calibrated_parameters(rig)}
    for field, patterns in (("drop", rig.fit.drop), ("hold", rig.fit.hold)):
        for k, pattern in enumerate(patterns):
            if not any(fnmatchcase(path, pattern) for path in known):
                raise InputError(
                    f"rig {rig.name!r}: fit.{field}.{k}: found {pattern!r}, which is no parameter"
                    " of this rig's list; `pneu fit --list` shows it"
                )

    def meets(path: str, patterns: list[str]) -> bool:
        return any(fnmatchcase(path, pattern) for pattern in patterns)

    kept = [p for p in every if not meets(p.path, rig.fit.drop)]
    return kept, [p.path for p in kept if meets(p.path, rig.fit.hold)]


def estimated_parameters(
    rig: Rig, given: list[FitParameter] | None = None
) -> tuple[list[FitParameter], list[str]]:
    """What a fit estimates of a rig.

    Args:
        rig: The rig.
        given: Instead of the list that follows from the rig.

    Returns:
        The parameters, and the paths of those that are held.

    Raises:
        InputError: A pattern of ``fit.drop`` or ``fit.hold`` meets nothing.
    """
    base = given or (
        calibrated_parameters(rig) if kind_of(rig).along_lines else default_parameters(rig)
    )
    return listed_parameters(rig, base)


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
                    std=std_inside(p, float(np.log(value))),
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
                    std=std_inside(p, value),
                )
            )
    return out


def in_short_steps(
    variables: Sequence[Variable], parameters: Sequence[FitParameter]
) -> list[Variable]:
    """Variables with short steps where they are known so well that kinks are nearer than steps.

    Args:
        variables: They.
        parameters: What they are of.
    """
    return [
        replace(v, step=SHORT * v.std) if p.log and v.std < WELL_KNOWN else v
        for v, p in zip(variables, parameters, strict=True)
    ]


def std_inside(p: FitParameter, centre: float) -> float:
    """What a parameter is uncertain by, as it is estimated: of a logarithm, relative to a centre.

    Args:
        p: The parameter.
        centre: What was known of it beforehand; a logarithm where the parameter is logarithmic.

    Returns:
        One standard deviation; infinite where nothing was known.
    """
    if p.std is None:
        return np.inf
    return p.std / float(np.exp(centre)) if p.log else p.std


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


def joined(fitted: list[FitParameter]) -> list[FitParameter]:
    """Parameters as a rig lists them: those with one value in each recording once.

    Args:
        fitted: What was fitted; of several the largest standard error counts.
    """
    out: dict[str, FitParameter] = {}
    for p in fitted:
        errors = [f.std_error for f in fitted if f.path == p.path and f.std_error is not None]
        update = {"recording": None, "std_error": max(errors) if errors else None}
        out.setdefault(p.path, p.model_copy(update=update))
    return list(out.values())
