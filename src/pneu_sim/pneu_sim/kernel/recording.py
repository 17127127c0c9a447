# SPDX-License-Identifier: Apache-2.0
"""Taps: what is written down, what the sensors read, and how readings correct the gas."""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, each, folded


@folded
def _at_tap(t, j, cells, chambers, taps):
    """Pressure of the gas at tap t of lane j."""
    w, p = cells.lanes, cells.work[L.W_P]
    slot = taps.slot[t, j]
    if slot < 0:
        return chambers.work[-1 - slot, L.H_PRESSURE, j]
    a = taps.weight[t, j]
    seen = (1.0 - a) * p[slot * w + j] + a * p[(slot + 1) * w + j]
    heads, resistance = taps.lost[t, 0, j], taps.lost[t, 1, j]
    if heads != 0.0 or resistance != 0.0:  # at a fitting between the tap and the middle of its cell
        i = taps.cell[t, j] * w + j
        flow = cells.state[L.MOM, i]
        seen += (heads * abs(flow) + resistance) * flow * cells.work[L.W_RI, i]
    return seen


@branching
def write_down(k, cells, ports, chambers, taps, record):
    """Pressures at taps, pressures and temperatures in chambers, and flows of ports, as sample k.

    Args:
        k: Number of the sample.
        cells: All slots.
        ports: Ports.
        chambers: Chambers.
        taps: Taps.
        record: Where to.
    """
    for j in range(cells.lanes):
        for t in range(record.taps.shape[1]):
            record.taps[k, t, j] = _at_tap(t, j, cells, chambers, taps)
        for q in range(record.flows.shape[1]):
            record.flows[k, q, j] = ports.flow[q, 0, j]
        for c in range(record.chambers.shape[1]):
            record.chambers[k, c, j] = chambers.work[c, L.H_PRESSURE, j]
            record.temperatures[k, c, j] = chambers.work[c, L.H_TEMPERATURE, j]


@branching
def write_down_motion(k, cylinders, bodies, record):
    """Where pistons and joints are, and how fast they move, as sample k.

    Args:
        k: Number of the sample.
        cylinders: Cylinders.
        bodies: Bodies.
        record: Where to.
    """
    for j in range(cylinders.state.shape[2]):
        for q in range(record.cylinders.shape[1]):
            record.cylinders[k, q, 0, j] = cylinders.state[q, L.SY_EXTENSION, j]
            record.cylinders[k, q, 1, j] = cylinders.state[q, L.SY_SPEED, j]
            record.cylinders[k, q, 2, j] = cylinders.state[q, L.SY_FORCE, j]
        for q in range(record.joints.shape[1]):
            record.joints[k, q, 0, j] = bodies.state[q, L.SJ_POSITION, j]
            record.joints[k, q, 1, j] = bodies.state[q, L.SJ_VELOCITY, j]


@branching
def find_fastest(k, cells, record):
    """How many cells the fastest wave crosses, by lane, at sample k; NaN where the gas is none.

    Args:
        k: Number of the sample.
        cells: All slots.
        record: Where to.
    """
    w, length = cells.lanes, cells.par[L.LENGTH]
    u, c = cells.work[L.W_U], cells.work[L.W_C]
    for j in range(w):
        record.fastest[k, j] = 0.0
    for first in range(0, length.size, w):
        for j in range(w):
            i = first + j
            crossed = (abs(u[i]) + c[i]) / length[i]  # negative in ghosts
            if crossed > record.fastest[k, j] or math.isnan(crossed):
                record.fastest[k, j] = crossed


@branching
def read(step, cells, chambers, taps):
    """Read the taps that are due since the last step; return whether the state is to be corrected.

    Between two steps a reading is linear. `Taps.error` gets what each tap asks of the state.

    Args:
        step: Steps since readings are counted.
        cells: All slots.
        chambers: Chambers.
        taps: Taps.
    """
    corrected = False
    sensor, time = taps.sensor, taps.time
    m = time.shape[1]
    for t in range(time.shape[0]):
        for j in range(cells.lanes):
            i = taps.next[t, j]
            taps.error[t, j] = 0.0
            # A sensor that does not lag need not be looked at until a reading is near.
            if sensor[t, L.SENSE_KEEP, j] == 0.0 and (i >= m or time[t, i, j] > step + 1):
                continue
            p = _at_tap(t, j, cells, chambers, taps)
            before = taps.shown[t, j]
            if math.isnan(before):
                before = p
                taps.shown[t, j] = p
            else:
                # First-order lag, exact for a pressure that is linear between steps.
                taps.shown[t, j] = (
                    sensor[t, L.SENSE_KEEP, j] * before
                    + sensor[t, L.SENSE_OLD, j] * taps.felt[t, j]
                    + sensor[t, L.SENSE_NEW, j] * p
                )
            taps.felt[t, j] = p
            while i < m and time[t, i, j] <= step:
                f = min(max(time[t, i, j] - (step - 1), 0.0), 1.0)
                value = before + f * (taps.shown[t, j] - before)
                gain = sensor[t, L.SENSE_GAIN, j]
                value = gain * value + sensor[t, L.SENSE_BIAS, j]
                taps.readings[t, i, j] = value
                # One in doubt (not a number) asks for nothing.
                asked = taps.gain[t, i, j] * (taps.measured[t, i, j] - value) / gain
                if asked > 0.0 or asked < 0.0:
                    taps.error[t, j] += asked
                    corrected = True
                i += 1
            taps.next[t, j] = i
    return corrected


@branching
def correct(cells, taps):
    """Correct the gas by what the taps ask, spread over lines.

    Gas is added or taken at its own temperature and velocity: what a model gets wrong that lasts is
    mass, and the wall keeps the temperature.

    Args:
        cells: All slots.
        taps: Taps.
    """
    w, X = cells.lanes, cells.work
    rho, mom, ene = cells.state[L.RHO], cells.state[L.MOM], cells.state[L.ENE]
    for i in each(rho.size // w):
        if cells.par[L.INV_VOLUME, i * w] <= 0.0:
            continue
        for j in range(w):
            d = 0.0
            for t in range(taps.error.shape[0]):
                d += taps.spread_slot[i, t] * taps.error[t, j]
            q = i * w + j
            grow = 1.0 + max(d / X[L.W_P, q], -0.5)
            rho[q] *= grow
            mom[q] *= grow
            ene[q] *= grow


@branching
def correct_chambers(chambers, taps):
    """Correct the gas in chambers by what the taps ask, as `correct` does it.

    Args:
        chambers: Chambers.
        taps: Taps.
    """
    for c in range(chambers.state.shape[0]):
        for j in range(chambers.state.shape[2]):
            d = 0.0
            for t in range(taps.error.shape[0]):
                d += taps.spread_chamber[c, t] * taps.error[t, j]
            grow = 1.0 + max(d / chambers.work[c, L.H_PRESSURE, j], -0.5)
            chambers.state[c, 0, j] *= grow
            chambers.state[c, 1, j] *= grow
