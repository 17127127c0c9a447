# SPDX-License-Identifier: Apache-2.0
"""From a rig and its effects to the numbers the kernels work on: one model per parameter set."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sim import layout as L
from pneu_sim.effects import apply_to_model, apply_to_rig
from pneu_sim.gas import AIR, Gas
from pneu_sim.kernel.orifices import ANR_DENSITY, ANR_TEMPERATURE
from pneu_sim.rig.cells import spread
from pneu_sim.rig.expand import with_cylinders
from pneu_sim.rig.lines import cells_of, lost_beyond
from pneu_sim.rig.mechanics import body_rows, cylinder_rows
from pneu_sim.rig.model import CURVE_POINTS, SENSOR_COLUMNS, VALVE_COLUMNS, Model
from pneu_sim.rig.opening import opening_at
from pneu_sim.rig.plan import Plan, plan_grid
from pneu_sim.rig.schema import Port, Rig, Spool, Valve
from pneu_sim.rig.valve_kinds import Switch

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def opening_table(port: Port, valve: Valve) -> tuple[Floats, Floats]:
    """An opening curve as a table over voltage, with the leakage of the closed port added.

    Args:
        port: The port.
        valve: Its valve.

    Returns:
        (CURVE_POINTS,) openings at even voltages, and (2,) the first and the last of these, V.
    """
    null = valve.spool.null_v
    source = (
        port.opening if port.opening.mirror is None else valve.ports[port.opening.mirror].opening
    )
    ends = [source.voltage_v[0], source.voltage_v[-1]]
    if source.interpolation == "power":
        ends = [min(null, ends[0]), max(null, ends[1])]
    table_v = np.linspace(ends[0], ends[1], CURVE_POINTS)
    table = opening_at(source, null, table_v)
    if port.opening.mirror is not None:
        table_v, table = 2.0 * null - table_v[::-1], table[::-1]
    lift = 0.0 if valve.regulator is not None else port.leakage
    table = lift + (1.0 - min(lift, 1.0)) * np.maximum(table, 0.0)
    return table, np.array([table_v[0], table_v[-1]])


def build(rig: Rig, plan: Plan | None = None, gas: Gas = AIR) -> Model:
    """Fills in the numbers of a rig on a grid plan.

    Args:
        rig: The rig; its attached effects are applied.
        plan: Grid plan; None makes the rig's own. Rigs run in one batch share one.
        gas: The gas.

    Returns:
        The model.
    """
    rig = apply_to_rig(rig)
    plan = plan or plan_grid(rig)
    rig = with_cylinders(rig)
    cell = cells_of(rig, plan, gas)
    end_area = cell[L.FACE, plan.ends[:, L.E_FACE]]
    for e in range(plan.ends.shape[0]):
        kind = plan.ends[e, L.E_KIND]
        if kind in (L.LINK, L.BRANCH):
            other = plan.ends[e, L.E_REF]
            cell[L.FACE, plan.ends[e, L.E_FACE]] = min(end_area[e], end_area[other])
    leaks, porous, reliefs = vents(rig, plan, gas)
    port, curve, curve_v, spool = _ports(rig, plan)
    tap_slot, tap_weight, tap_cell, tap_lost, sensor = _taps(rig, plan, cell)
    body, joint = body_rows(rig)
    model = Model(
        plan=plan,
        gas=gas,
        cell=cell,
        port=port,
        reservoir=_reservoirs(rig),
        chamber=_chambers(rig, gas),
        cylinder=cylinder_rows(rig),
        body=body,
        joint=joint,
        leaks=leaks,
        porous=porous,
        reliefs=reliefs,
        ripples={
            k: [
                (r.amplitude_pa, 2.0 * math.pi * r.frequency_hz, r.phase_rad)
                for r in source.ripples
            ]
            for k, source in enumerate(rig.reservoirs.values())
            if source.ripples
        },
        spool=spool,
        curve=curve,
        curve_v=curve_v,
        tap_slot=tap_slot,
        tap_weight=tap_weight,
        tap_cell=tap_cell,
        tap_lost=tap_lost,
        sensor=sensor,
        encoder=_encoders(rig),
        ambient=np.array([rig.ambient.pressure_pa, rig.ambient.temperature_k]),
        end_area=end_area,
        order=rig.grid.order,
        flux=L.HLLC if rig.grid.flux == "hllc" else L.EXACT,
        limiter=L.MINMOD if rig.grid.limiter == "minmod" else L.VAN_LEER,
        newton=rig.grid.newton_iterations,
        memory=rig.grid.memory,
        thesis_joints=rig.grid.thesis_joints,
        regulator=_regulators(rig),
    )
    apply_to_model(rig, model)
    model.compliant = bool(np.any(model.cell[L.COMPLIANCE] > 0.0))
    return model


def vents(
    rig: Rig, plan: Plan, gas: Gas
) -> tuple[dict[int, float], dict[int, float], dict[int, list[tuple[float, float, float]]]]:
    """Leaks, porous leaks and relief valves by slot; of chamber c at ``-1 - c``.

    Args:
        rig: The rig, its effects applied.
        plan: Its grid plan.
        gas: The gas.

    Returns:
        As `Model.leaks`, `Model.porous` and `Model.reliefs` have them.
    """
    leaks: dict[int, float] = {}
    porous: dict[int, float] = {}
    reliefs: dict[int, list[tuple[float, float, float]]] = {}
    room_k = rig.ambient.temperature_k
    # Poiseuille or Darcy, isothermal at the room's temperature, which the plug has.
    per_porous = 1.0 / (2.0 * float(gas.viscosity(room_k)) * gas.r_specific * room_k)
    for name, pipe in rig.pipes.items():
        first, n = plan.pipes[name]
        faces = np.linspace(0.0, pipe.length_m, n + 1)
        centres = 0.5 * (faces[1:] + faces[:-1])
        for leak in pipe.leaks:
            for i, share in spread(leak.position_m, centres):
                if leak.area_m2 > 0.0:
                    leaks[first + i] = leaks.get(first + i, 0.0) + share * leak.area_m2
                if leak.porous_m3 > 0.0:
                    more = share * leak.porous_m3 * per_porous
                    porous[first + i] = porous.get(first + i, 0.0) + more
        for relief in pipe.reliefs:
            for i, share in spread(relief.position_m, centres):
                of_slot = reliefs.setdefault(first + i, [])
                of_slot.append((share * relief.area_m2, relief.set_pa, relief.range_pa))
    for c, chamber in enumerate(rig.chambers.values()):
        if chamber.leak_area_m2 > 0.0:
            leaks[-1 - c] = chamber.leak_area_m2
        if chamber.leak_porous_m3 > 0.0:
            porous[-1 - c] = chamber.leak_porous_m3 * per_porous
        if chamber.reliefs:
            reliefs[-1 - c] = [(r.area_m2, r.set_pa, r.range_pa) for r in chamber.reliefs]
    return leaks, porous, reliefs


def _ports(rig: Rig, plan: Plan) -> tuple[Floats, Floats, Floats, Floats]:
    """Ports and orifices, their opening curves over which voltages, and the valves' spools."""
    port = np.zeros((plan.ports.shape[0], L.PORT_PARAMS))
    curve = np.ones((plan.ports.shape[0], CURVE_POINTS))
    curve_v = np.tile([0.0, 1.0], (plan.ports.shape[0], 1))
    spool = np.zeros((len(rig.valves), VALVE_COLUMNS))
    q = 0
    for v, valve in enumerate(rig.valves.values()):
        spool[v] = spool_row(valve.spool, valve.switch)
        for p in valve.ports.values():
            port[q] = (
                p.conductance_m3_s_pa,
                p.critical_ratio,
                p.area_m2,
                p.laminar_ratio,
                p.jet_loss,
                p.inlet_head,
                p.laminar_widening,
                p.laminar_share,
            )
            curve[q], curve_v[q] = opening_table(p, valve)
            q += 1
    for o in rig.orifices.values():
        port[q] = (
            o.conductance_m3_s_pa,
            o.critical_ratio,
            0.0,
            o.laminar_ratio,
            1.0,
            1.0,
            0.0,
            1.0,
        )
        q += 1
    return port, curve, curve_v, spool


def _reservoirs(rig: Rig) -> Floats:
    """(n_reservoirs, RESERVOIR_PARAMS)."""
    room_k = rig.ambient.temperature_k
    rows = [
        (
            r.pressure_pa,
            r.temperature_k or room_k,
            r.droop_pa_s_per_kg,
            r.droop_tau_s,
            r.inlet_loss,
        )
        for r in rig.reservoirs.values()
    ]
    return np.array(rows).reshape(-1, L.RESERVOIR_PARAMS)


def _chambers(rig: Rig, gas: Gas) -> Floats:
    """(n_chambers, CHAMBER_PARAMS)."""
    room = rig.ambient
    rows = np.zeros((len(rig.chambers), L.CHAMBER_PARAMS))
    for row, c in zip(rows, rig.chambers.values(), strict=True):
        row[L.C_VOLUME] = c.volume_m3
        row[L.C_COMPLIANCE] = c.compliance_m3_per_pa
        row[L.C_HEAT] = c.heat_w_per_k
        row[L.C_WALL_T] = room.temperature_k
        row[L.C_REST_P] = room.pressure_pa
        row[L.C_CONVECTION] = c.convection_m2
        row[L.C_HEIGHT] = c.height_m or math.cbrt(c.volume_m3)
        row[L.C_INLET] = c.inlet_m or 0.0
        row[L.C_STIRRED] = 0.0 if c.inlet_m is None else 1.0
        row[L.C_VISCOUS] = gas.mu_ref * (gas.t_ref + gas.sutherland_k) / gas.t_ref**1.5
        row[L.C_SUTHERLAND] = gas.sutherland_k
    return rows


def _taps(rig: Rig, plan: Plan, cell: Floats) -> tuple[Ints, Floats, Ints, Floats, Floats]:
    """The slot and the weight of the next one that each tap is read by, and its sensor.

    Besides the slot whose flow loses pressure between what is read and the tap, and what it loses
    of m |m| / rho and of m / rho, see `lost_beyond`.
    """
    slot = np.zeros(len(rig.taps), dtype=np.int64)
    weight = np.zeros(len(rig.taps))
    passed = np.zeros(len(rig.taps), dtype=np.int64)
    lost = np.zeros((len(rig.taps), 2))
    sensor = np.zeros((len(rig.taps), SENSOR_COLUMNS))
    for t, tap in enumerate(rig.taps.values()):
        sensor[t] = (tap.lag_s, tap.gain, tap.bias_pa, tap.offset_s)
        if tap.chamber is not None:
            slot[t] = -1 - plan.chambers.index(tap.chamber)
            continue
        assert tap.pipe is not None
        first, n = plan.pipes[tap.pipe]
        at = tap.position_m / (rig.pipes[tap.pipe].length_m / n) - 0.5
        e = 2 * list(rig.pipes).index(tap.pipe)
        sees_ghost = [plan.ends[e + side, L.E_KIND] in (L.RESERVOIR, L.LINK) for side in (0, 1)]
        flat = [plan.ends[e + side, L.E_KIND] == L.WALL for side in (0, 1)]
        if at < 0.0 and not sees_ghost[0]:
            left, weight[t] = 0, 0.0 if flat[0] else at
        elif at > n - 1 and not sees_ghost[1]:
            left, weight[t] = n - 2, 1.0 if flat[1] else at - (n - 2)
        else:
            left = min(max(math.floor(at), -1), n - 1)
            weight[t] = at - left
        slot[t] = first + left
        # how much of what is read lies in each outermost cell, or beyond it
        at_first = 1.0 if left < 0 else 1.0 - weight[t] if left == 0 else 0.0
        at_last = 1.0 if left > n - 2 else weight[t] if left == n - 2 else 0.0
        beyond = lost_beyond(rig.pipes[tap.pipe], n, tap.position_m)
        for turn, share, outer in ((-1.0, at_first, 0), (1.0, at_last, n - 1)):
            heads, resistance = beyond[min(outer, 1)]
            if share != 0.0 and heads + resistance > 0.0:
                passed[t] = first + outer
                area = cell[L.AREA, passed[t]]
                lost[t] = turn * share * 0.5 * heads * area**2, turn * share * resistance * area
    return slot, weight, passed, lost, sensor


def _encoders(rig: Rig) -> Floats:
    """(n_encoders, SENSOR_COLUMNS)."""
    rows = [(e.lag_s, e.gain, e.bias, e.offset_s) for e in rig.encoders.values()]
    return np.array(rows, dtype=np.float64).reshape(-1, SENSOR_COLUMNS)


def _regulators(rig: Rig) -> Floats:
    """(n_regulators, REG_PARAMS)."""
    rows = []
    for valve in rig.valves.values():
        r = valve.regulator
        if r is not None:
            rows.append(
                (
                    r.low_pa,
                    r.high_pa - r.low_pa,
                    r.dead_zone_pa,
                    r.full_open_pa,
                    0.5 / (math.pi * r.bandwidth_hz),
                    r.sensor_lag_s,
                    0.0 if r.integral_s is None else 1.0 / r.integral_s,
                    valve.ports[r.fill].leakage,
                    valve.ports[r.vent].leakage,
                )
            )
    return np.array(rows).reshape(-1, L.REG_PARAMS)


def spool_row(spool: Spool, switch: Switch | None = None) -> Floats:
    """(VALVE_COLUMNS,) a spool in numbers, see `Model.spool`.

    Args:
        spool: The spool.
        switch: What the command becomes before the spool is told.
    """
    s = spool
    switched = (0.0, 0.0, 0.0, 0.0)
    if switch is not None:
        period_s = 0.0 if switch.pwm_hz is None else 1.0 / switch.pwm_hz
        switched = (switch.off_v, switch.on_v, switch.threshold_v, period_s)
    return np.array(
        [
            0.0 if s.bandwidth_hz is None else 2.0 * math.pi * s.bandwidth_hz,
            s.damping,
            s.integral,
            math.inf if s.max_acceleration_v_s2 is None else s.max_acceleration_v_s2,
            s.delay_s,
            s.hysteresis_v,
            s.null_offset_v,
            s.dead_band_v,
            s.null_v,
            math.inf if s.max_speed_v_s is None else s.max_speed_v_s,
            0.0 if s.closing_delay_s is None else s.closing_delay_s - s.delay_s,
            *switched,
        ]
    )


def area_steps(models: Sequence[Model]) -> tuple[Ints, Floats]:
    """Faces at which the area jumps, or a fitting is, in any of some models on one plan.

    Args:
        models: The models.

    Returns:
        ``(index, area)`` as the kernel takes them: (n_steps, 5) integers and
        (n_steps, 2, n_models).
    """
    plan = models[0].plan
    index: list[tuple[int, int, int, int, int]] = []
    area: list[Floats] = []
    here = np.stack([m.cell[L.AREA] for m in models], axis=-1)
    smooth = np.stack([m.cell[L.TAPER] != 0.0 for m in models], axis=-1)
    narrow = np.stack([m.cell[L.FACE] for m in models], axis=-1)[:-1]
    lossy = np.stack([m.cell[L.LOSS] + m.cell[L.RESISTANCE] > 0.0 for m in models], axis=-1)[:-1]
    jump = (here[:-1] != here[1:]) | (narrow < np.minimum(here[:-1], here[1:]))
    jump &= ~(smooth[:-1] | smooth[1:])
    if models[0].thesis_joints:
        jump[:] = False
    for first, n in plan.pipes.values():
        if n == 1 and lossy[first].any():  # on the gas of the cell: it has no face to a next one
            index.append((first, first, 1, first, 1))
            area.append(np.array([[m.cell[L.FACE, first] for m in models]] * 2))
        there = (jump | lossy)[first : first + n - 1].any(axis=1)
        for f in (first + np.flatnonzero(there)).tolist():
            face = np.array([m.cell[L.FACE, f] for m in models])
            index.append((f, f, 1, f + 1, 1))
            area.append(np.where(jump[f], here[f : f + 2], face))
    links = [] if models[0].thesis_joints else plan.ends.tolist()
    for e, (cell, _, face, sign, kind, other) in enumerate(links):
        if kind != L.LINK or e > other:
            continue  # the first of two linked ends carries the face
        own = np.array([m.end_area[e] for m in models])
        far = np.array([m.end_area[other] for m in models])
        if np.any(own != far):
            turn = -1 if plan.ends[other, L.E_SIGN] == sign else 1
            there = int(plan.ends[other, L.E_CELL])
            if sign > 0:
                index.append((face, cell, 1, there, turn))
                area.append(np.array([own, far]))
            else:
                index.append((face, there, turn, cell, 1))
                area.append(np.array([far, own]))
    return (
        np.array(index, dtype=np.int64).reshape(-1, 5),
        np.array(area).reshape(-1, 2, len(models)),
    )


def side_volumes(models: Sequence[Model]) -> tuple[Ints, Floats]:
    """Cells that have a volume beside them in any of some models on one plan.

    Args:
        models: The models.

    Returns:
        (n_sides, SIDE_COLUMNS) cells; and (n_sides, n_models) how many times the cell's own volume
        that beside it is.
    """
    plan = models[0].plan
    cell = np.stack([m.cell for m in models], axis=-1)
    own = cell[L.AREA] * cell[L.LENGTH] * cell[L.INV_VOLUME]
    there = (cell[L.INV_VOLUME] > 0.0) & (own < 1.0 - 1e-12)
    slots = np.flatnonzero(there.any(axis=1))
    at_end = {
        int(end[L.E_CELL]): e
        for e, end in enumerate(plan.ends)
        if end[L.E_KIND] in (L.WALL, L.PORTED)
    }
    table = [(slot, at_end.get(slot, -1)) for slot in slots.tolist()]
    more = np.where(there[slots], 1.0 / np.where(there[slots], own[slots], 1.0) - 1.0, 0.0)
    return np.array(table, dtype=np.int64).reshape(-1, L.SIDE_COLUMNS), more


def small_chambers(models: Sequence[Model]) -> tuple[Ints, Floats]:
    """Chambers that fill or empty within a step in any of some models on one plan.

    Of an explicit step the pressure overshoots where a step is longer than the chamber's time
    constant, V / (gamma R T G), G being by how much the flow of all that is connected grows with
    pressure: of a pipe's end A / c, of a port its slope where it is steepest, at pressures that are
    nearly equal.

    Args:
        models: The models.

    Returns:
        (n_small,) their numbers; and (n_small, n_models) 1 for the models in which they are, else
        0. Chambers of cylinders are none.
    """
    plan = models[0].plan
    stiff = np.zeros((len(plan.chambers), len(models)))
    for j, model in enumerate(models):
        gas, t = model.gas, float(model.ambient[1])
        rt = gas.r_specific * t
        give = np.zeros(len(plan.chambers))
        for end, area in zip(plan.ends, model.end_area, strict=True):
            if end[L.E_KIND] == L.CHAMBER:
                give[end[L.E_REF]] += area / math.sqrt(gas.gamma * rt)
        for port, par in zip(plan.ports, model.port, strict=True):
            ratio = par[L.Q_RATIO]
            # ISO 6358-1 itself takes the flow as linear in the last thousandth of the pressure
            linear = min(par[L.Q_LAMINAR], 0.999)
            steepest = math.sqrt((1.0 - ratio) ** 2 - (linear - ratio) ** 2)
            steepest *= par[L.Q_CONDUCTANCE] * ANR_DENSITY * math.sqrt(ANR_TEMPERATURE / t)
            steepest /= (1.0 - ratio) * (1.0 - linear)
            for kind, ref in ((L.P_A, L.P_AI), (L.P_B, L.P_BI)):
                if port[kind] == L.SIDE_CHAMBER:
                    give[port[ref]] += steepest
        for slot, area in model.leaks.items():
            if slot < 0:  # sonic as soon as it may be: area / sqrt(R T) is its slope there
                give[-1 - slot] += area / math.sqrt(rt)
        for slot, reliefs in model.reliefs.items():
            if slot < 0:
                for area, opens, span in reliefs:
                    give[-1 - slot] += area / math.sqrt(rt) * (1.0 + (opens + span) / span)
        volume = model.chamber[:, L.C_VOLUME]
        stiff[:, j] = plan.dt_s * gas.gamma * rt * give > volume
    for sides in plan.cylinder:
        for side in range(2):
            kind, c, _ = sides[L.COLUMNS_PER_SIDE * side : L.COLUMNS_PER_SIDE * (side + 1)]
            if kind == L.GAS_CHAMBER:
                stiff[c] = 0.0
    small = np.flatnonzero(stiff.any(axis=1)).astype(np.int64)
    return small, stiff[small]
