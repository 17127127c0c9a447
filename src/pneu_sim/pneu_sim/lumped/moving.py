# SPDX-License-Identifier: Apache-2.0
"""Thin-plate models of rigs whose cylinders move: volumes that grow and shrink, and no lines.

What lines hold is added to the vessel that they end in, and ports open into that (thesis 3.2.1;
Todorov et al., ICRA 2010). All else is as in the full model: the gas of a vessel with its heat, the
pistons with their friction, the bodies. So a difference from the full model is one of the lines.

Ports are ISO 6358's at the critical ratio of an ideal orifice, ``(2 / (g + 1))^(g / (g - 1))``,
where the standard's ellipse differs from thesis eq. 3.16 by less than 0.4 % of the choked flow.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim.coupled import CoupledSolver
from pneu_sim.effects import apply_to_rig
from pneu_sim.full_solver import FullSolver
from pneu_sim.gas import AIR, Gas
from pneu_sim.rig.build import build, vents
from pneu_sim.rig.expand import with_cylinders
from pneu_sim.rig.lines import cells_of
from pneu_sim.rig.model import Model
from pneu_sim.rig.network import joined
from pneu_sim.rig.plan import common_plan, plan_grid
from pneu_sim.rig.schema import Port, Rig
from pneu_sim.solver import no_lines

Floats = NDArray[np.float64]

STEP_DX_M = 0.2
"""Cell length whose time step vessels alone take, m; they have no waves that would ask for less."""


def critical_ratio(gas: Gas) -> float:
    """Critical pressure ratio of an ideal orifice (thesis eq. 3.15).

    Args:
        gas: The gas.
    """
    g = gas.gamma
    return float((2.0 / (g + 1.0)) ** (g / (g - 1.0)))


def without_lines(rig: Rig, gas: Gas = AIR) -> Rig:
    """A rig whose lines are part of the vessels that they end in.

    Args:
        rig: The rig; its effects are worked in, those on lines as far as they change a volume.
        gas: The gas.

    Returns:
        The rig; only for what reads it: it is not checked, and not to be written to a file.

    Raises:
        InputError: A line ends in no vessel or in several, a tap sits on a line open to a
            reservoir, or a cylinder's gas is held in cells.
    """
    for name, cylinder in rig.cylinders.items():
        if cylinder.gas == "cells":
            raise InputError(
                f"rig {rig.name!r}: cylinders.{name}.gas: found cells, of which model {rig.model}"
                " has none; use chamber"
            )
    rig = apply_to_rig(rig)
    vessel = _vessels(rig)
    held = _held_by_lines(rig, vessel, gas)
    b = critical_ratio(gas)

    def at(node: str) -> str:
        return vessel.get(node, node)

    def plate(port: Port) -> Port:
        c = port.conductance_m3_s_pa
        if port.model == "effective_area":
            c = float(gas.conductance_from_area(port.area_m2))
        return port.model_copy(
            update={
                "from_node": at(port.from_node),
                "to_node": at(port.to_node),
                "model": "iso6358",
                "conductance_m3_s_pa": rig.lumped.discharge * c,
                "critical_ratio": b,
            }
        )

    valves = {
        name: valve.model_copy(
            update={"ports": {key: plate(port) for key, port in valve.ports.items()}}
        )
        for name, valve in rig.valves.items()
    }
    orifices = {
        name: orifice.model_copy(
            update={"from_node": at(orifice.from_node), "to_node": at(orifice.to_node)}
        )
        for name, orifice in rig.orifices.items()
    }
    chambers = {
        name: chamber.model_copy(update={"volume_m3": chamber.volume_m3 + held.get(name, 0.0)})
        for name, chamber in rig.chambers.items()
    }
    taps = {}
    for name, tap in rig.taps.items():
        if tap.pipe is None:
            taps[name] = tap
            continue
        there = vessel[f"pipe:{tap.pipe}"]
        if there in rig.reservoirs:
            raise InputError(
                f"rig {rig.name!r}: taps.{name}: found line {tap.pipe!r}, which is open to"
                f" reservoir {there!r}; model {rig.model} has no gas there, use pde"
            )
        taps[name] = tap.model_copy(update={"pipe": None, "position_m": 0.0, "chamber": there})
    cylinders = {}
    for name, cylinder in rig.cylinders.items():
        sides: dict[str, Any] = {}
        for key, side in cylinder.sides.items():
            more = side.dead_volume_m3 + held.get(side.node, 0.0)
            sides[key] = side.model_copy(update={"dead_volume_m3": more})
        cylinders[name] = cylinder.model_copy(update=sides)
    return rig.model_copy(
        update={
            "grid": rig.grid.model_copy(update={"dx_m": STEP_DX_M, "dt_s": None}),
            "pipes": {},
            "chambers": chambers,
            "cylinders": cylinders,
            "valves": valves,
            "orifices": orifices,
            "taps": taps,
            "effects": [],
        }
    )


def _vessels(rig: Rig) -> dict[str, str]:
    """By node and ``pipe:name`` of the lines the vessel that they end in."""
    group = joined(with_cylinders(rig))
    inside: dict[str, list[str]] = {}
    for name in (*rig.reservoirs, *with_cylinders(rig).chambers):
        inside.setdefault(group.get(name, name), []).append(name)
    for name in rig.pipes:
        found = inside.get(group[f"pipe:{name}"], [])
        if len(found) != 1:
            raise InputError(
                f"rig {rig.name!r}: pipes.{name}: found {' and '.join(found) or 'no vessel'} at its"
                f" ends; model {rig.model} of a rig that moves needs one vessel to each line, use"
                " pde"
            )
    return {item: inside[root][0] for item, root in group.items() if root in inside}


def _held_by_lines(rig: Rig, vessel: dict[str, str], gas: Gas) -> dict[str, float]:
    """Volume that the lines of every vessel hold, m^3."""
    plan = plan_grid(rig)
    size = 1.0 / np.maximum(cells_of(with_cylinders(rig), plan, gas)[L.INV_VOLUME], 1e-300)
    held: dict[str, float] = {}
    for name in rig.pipes:
        first, n = plan.pipes[name]
        there = vessel[f"pipe:{name}"]
        held[there] = held.get(there, 0.0) + float(size[first : first + n].sum())
    return held


def moving_solver(rigs: Sequence[Rig], gas: Gas = AIR) -> FullSolver:
    """What steps rigs without their lines side by side.

    Args:
        rigs: The rigs, of one structure.
        gas: The gas.

    Raises:
        InputError: A rig has no such reduction.
    """
    reduced = [without_lines(rig, gas) for rig in rigs]
    plan = common_plan(reduced)
    models = [build(rig, plan, gas) for rig in reduced]
    for model, rig in zip(models, rigs, strict=True):
        _add_what_lines_have(model, apply_to_rig(rig), gas)
    return Lineless(models) if rigs[0].mechanism is None else LinelessMechanism(models, reduced)


def _add_what_lines_have(model: Model, rig: Rig, gas: Gas) -> None:
    """Has vessels leak, blow off and yield as the lines do that are part of them.

    Args:
        model: Of the vessels alone; changed.
        rig: The rig with its lines, its effects worked in.
        gas: The gas.
    """
    whole = with_cylinders(rig)
    plan, vessel = plan_grid(whole), _vessels(rig)
    cell = cells_of(whole, plan, gas)
    leaks, porous, reliefs = vents(whole, plan, gas)
    for name in rig.pipes:
        there = vessel[f"pipe:{name}"]
        if there in rig.reservoirs:
            continue
        c = model.plan.chambers.index(there)
        first, n = plan.pipes[name]
        span = range(first, first + n)
        yields = cell[L.COMPLIANCE, span] / cell[L.INV_VOLUME, span]
        model.chamber[c, L.C_COMPLIANCE] += float(yields.sum())
        for slot in span:
            for of_lines, of_vessels in ((leaks, model.leaks), (porous, model.porous)):
                if slot in of_lines:
                    of_vessels[-1 - c] = of_vessels.get(-1 - c, 0.0) + of_lines[slot]
            if slot in reliefs:
                model.reliefs.setdefault(-1 - c, []).extend(reliefs[slot])


class Lineless(FullSolver):
    """Vessels without lines, stepped by the kernel of the full model."""

    def fill(
        self,
        pressure_pa: Floats,
        chamber_pressure_pa: Floats,
        temperature_k: Floats,
        chamber_temperature_k: Floats,
    ) -> None:
        """Fills the vessels with gas at rest; see `Solver.fill`.

        Args:
            pressure_pa: Not looked at: there are no lines.
            chamber_pressure_pa: (n_chambers, lanes).
            temperature_k: Not looked at.
            chamber_temperature_k: (n_chambers, lanes).
        """
        del pressure_pa, temperature_k
        room = np.stack([model.ambient for model in self.models], axis=-1)
        pressure, temperature = (np.tile(of, (self.plan.slots, 1)) for of in room)
        super().fill(pressure, chamber_pressure_pa, temperature, chamber_temperature_k)

    def gas_in(self, pipe: str) -> tuple[Floats, Floats, Floats]:
        """There is none; see `Solver.gas_in`.

        Args:
            pipe: Name of the pipe.
        """
        raise no_lines(pipe)

    def set_gas(self, pipe: str, density: Floats, velocity: Floats, pressure: Floats) -> None:
        """There is none; see `Solver.set_gas`.

        Args:
            pipe: Name of the pipe.
            density: (cells, lanes).
            velocity: (cells, lanes).
            pressure: (cells, lanes).
        """
        raise no_lines(pipe)


class LinelessMechanism(Lineless, CoupledSolver):
    """The same with a mechanism that MuJoCo moves."""
