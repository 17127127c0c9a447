# SPDX-License-Identifier: Apache-2.0
"""Encoders: what they read of joints and pistons, and how their readings correct the motion."""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, folded
from pneu_sim.kernel.bodies import stand
from pneu_sim.kernel.equations.kinds import levers
from pneu_sim.kernel.pistons import settle


@folded
def _position(e, j, cylinders, bodies, encoders):
    """Position that encoder e of lane j is on."""
    of = encoders.of[e]
    if of >= 0:
        return bodies.state[of, L.SJ_POSITION, j]
    return cylinders.state[-1 - of, L.SY_EXTENSION, j]


@branching
def read_encoders(step, cylinders, bodies, encoders):
    """Read the encoders that are due; return whether the motion is to be corrected.

    As `recording.read` does with taps; `Encoders.shift` gets what each asks of the motion.

    Args:
        step: Steps since readings are counted.
        cylinders: Cylinders.
        bodies: Bodies.
        encoders: Encoders.
    """
    corrected = False
    sensor, time = encoders.sensor, encoders.time
    m = time.shape[1]
    for e in range(time.shape[0]):
        for j in range(time.shape[2]):
            encoders.shift[e, 0, j] = 0.0
            encoders.shift[e, 1, j] = 0.0
            i = encoders.next[e, j]
            if sensor[e, L.SENSE_KEEP, j] == 0.0 and (i >= m or time[e, i, j] > step + 1):
                continue
            x = _position(e, j, cylinders, bodies, encoders)
            before = encoders.shown[e, j]
            if math.isnan(before):
                before = x
                encoders.shown[e, j] = x
            else:
                encoders.shown[e, j] = (
                    sensor[e, L.SENSE_KEEP, j] * before
                    + sensor[e, L.SENSE_OLD, j] * encoders.felt[e, j]
                    + sensor[e, L.SENSE_NEW, j] * x
                )
            encoders.felt[e, j] = x
            while i < m and time[e, i, j] <= step:
                f = min(max(time[e, i, j] - (step - 1), 0.0), 1.0)
                value = before + f * (encoders.shown[e, j] - before)
                gain = sensor[e, L.SENSE_GAIN, j]
                value = gain * value + sensor[e, L.SENSE_BIAS, j]
                encoders.readings[e, i, j] = value
                error = (encoders.measured[e, i, j] - value) / gain
                if error > 0.0 or error < 0.0:  # not where nothing was measured
                    encoders.shift[e, 0, j] += encoders.gain[e, i, j] * error
                    encoders.shift[e, 1, j] += encoders.push[e, i, j] * error
                    corrected = corrected or encoders.gain[e, i, j] > 0.0
                i += 1
            encoders.next[e, j] = i
    return corrected


@folded
def _shift_piston(k, j, way, speed, cylinders, bodies):
    """Shift the joints of the body that a piston moves, so that the piston moves by some way."""
    b = cylinders.moves[k]
    if b < 0:
        return
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    place, places = bodies.table[b, L.B_PLACE], bodies.table[b, L.B_PLACES]
    for i in range(n):
        bodies.q[i] = bodies.state[first + i, L.SJ_POSITION, j]
    levers(bodies.table[b, L.B_KIND], bodies.par, b, j, bodies.q, bodies.x, bodies.lever)
    for c in range(places):
        if bodies.driven_by[place + c] != k:
            continue
        square = 0.0
        for i in range(n):
            if bodies.joint[first + i, L.PJ_HELD, j] == 0.0:
                square += bodies.lever[c, i] * bodies.lever[c, i]
        for i in range(n):
            if bodies.joint[first + i, L.PJ_HELD, j] == 0.0 and square > 0.0:
                share = bodies.lever[c, i] / square
                bodies.state[first + i, L.SJ_POSITION, j] += share * way
                bodies.state[first + i, L.SJ_VELOCITY, j] += share * speed


@branching
def correct_motion(cells, chambers, cylinders, bodies, encoders):
    """Correct joints by what the encoders ask; gas keeps its pressure and temperature.

    Args:
        cells: All slots.
        chambers: Chambers.
        cylinders: Cylinders.
        bodies: Bodies.
        encoders: Encoders.
    """
    w = cells.lanes
    for e in range(encoders.of.shape[0]):
        of = encoders.of[e]
        for j in range(w):
            way, speed = encoders.shift[e, 0, j], encoders.shift[e, 1, j]
            if of < 0:
                _shift_piston(-1 - of, j, way, speed, cylinders, bodies)
            elif bodies.joint[of, L.PJ_HELD, j] == 0.0:
                bodies.state[of, L.SJ_POSITION, j] += way
                bodies.state[of, L.SJ_VELOCITY, j] += speed
    # (the row is free between two steps)
    for c in range(chambers.state.shape[0]):
        for j in range(w):
            chambers.work[c, L.H_MIDDLE, j] = chambers.par[c, L.C_VOLUME, j]
    stand(bodies, cylinders)
    settle(cells, chambers, cylinders)
    for c in range(chambers.state.shape[0]):
        for j in range(w):
            grown = chambers.par[c, L.C_VOLUME, j] / chambers.work[c, L.H_MIDDLE, j]
            chambers.state[c, 0, j] *= grown
            chambers.state[c, 1, j] *= grown
