# SPDX-License-Identifier: Apache-2.0
"""Bodies that pistons move: equations of motion, dry friction that sticks, and stops.

A step is the midpoint rule, second order: forces are those at the middle of the step, of the gas
(`pistons.press`) and of positions and velocities foreseen there. Damping and springs are implicit.
Dry friction is an impulse that takes the velocity of a joint or piston away, as far as it reaches
(projected Gauss-Seidel; Stewart and Trinkle 1996). What a body gains is force times way.
"""

import math

from pneu_sim import layout as L
from pneu_sim.compiling import branching, entry, folded
from pneu_sim.kernel.equations.kinds import RAIL, levers, mechanics
from pneu_sim.kernel.play import (
    LEANS,
    LOOSE,
    has_play,
    is_played,
    lean,
    look_from,
    stay_within,
)

HOLD_STEPS, HELD = 30, 1e-12
"""Of Newton's method for friction of soft seals, at most; the share of the greatest impulse to
which it is found."""
PARTS = 32
"""Of a step of MuJoCo, in which dry friction is resolved: its error is of first order in them."""
SWEEPS = 12
"""Of Gauss-Seidel, for bodies of several joints; one joint needs two."""
LET_GO = -2.0
"""What ``Bodies.row`` says of a piston that lets go of the face of its play."""
MOST_LOOSE = 0.9
"""Part of a body's mass that its loose pistons may be, seen from each joint."""
AT_REST = 1e-7
"""Speed, m/s or rad/s, below which seals hold as at rest."""


@folded
def _middle(b, j, dt, bodies, share):
    """Positions and velocities some share of a step on, as the last step's forces have them."""
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    for i in range(n):
        x = bodies.state[first + i, L.SJ_POSITION, j]
        v = bodies.state[first + i, L.SJ_VELOCITY, j]
        a = bodies.state[first + i, L.SJ_PUSH, j]
        h = share * dt
        bodies.q[i] = x + h * (v + 0.5 * h * a)
        bodies.v[i] = v + h * a


@branching
def foresee(dt, bodies, cylinders):
    """Speed that every piston has at the middle of the step, as far as the last step tells.

    Args:
        dt: Step, s.
        bodies: Bodies.
        cylinders: Cylinders; those that move no body keep the speed that they are told.
    """
    for k in range(cylinders.table.shape[0]):
        for j in range(cylinders.work.shape[2]):
            cylinders.work[k, L.WY_SPEED, j] = cylinders.state[k, L.SY_SPEED, j]
    for b in range(bodies.table.shape[0]):
        kind, n = bodies.table[b, L.B_KIND], bodies.table[b, L.B_JOINTS]
        place, places = bodies.table[b, L.B_PLACE], bodies.table[b, L.B_PLACES]
        for j in range(bodies.state.shape[2]):
            _middle(b, j, dt, bodies, 0.5)
            levers(kind, bodies.par, b, j, bodies.q, bodies.x, bodies.lever)
            played = has_play(b, j, bodies)
            if played:
                lean(b, j, bodies, cylinders)
            for c in range(places):
                k = bodies.driven_by[place + c]
                speed = 0.0
                for i in range(n):
                    speed += bodies.lever[c, i] * bodies.v[i]
                if played and bodies.loose[c] == LOOSE:
                    speed = cylinders.state[k, L.SY_SPEED, j]
                    speed += 0.5 * dt * cylinders.state[k, L.SY_PUSH, j]
                cylinders.work[k, L.WY_SPEED, j] = speed


@folded
def _grip(k, j, speed, cylinders):
    """How hard the seals of a cylinder hold, N."""
    par, work = cylinders.par, cylinders.work
    gauge = 0.5 * (work[k, L.WY_FACE, j] + work[k, L.WY_FACE_ROD, j]) - par[k, L.PY_ROOM_P, j]
    grip = par[k, L.PY_COULOMB, j] + par[k, L.PY_PER_PA, j] * max(gauge, 0.0)
    more = par[k, L.PY_BREAKAWAY, j]
    if more > 0.0:
        x = speed / par[k, L.PY_STRIBECK, j]
        grip += more if abs(speed) < AT_REST else more * math.exp(-x * x)
    return grip


@folded
def _touch(depth, closing, dt):
    """Part of a step in which a stop is touched, and how deep on the mean of the whole step.

    Where it begins or ends within the step that part is counted, so that what a stop does changes
    smoothly with where and when it was met.

    Args:
        depth: How deep the body is in it at the beginning; negative outside.
        closing: How fast that grows.
        dt: Step, s.
    """
    after = depth + dt * closing
    if depth >= 0.0 and after >= 0.0:
        return 1.0, 0.5 * (depth + after)
    inner = max(depth, after)
    if inner <= 0.0:
        return 0.0, 0.0
    share = inner / abs(after - depth)
    return share, 0.5 * share * inner


@folded
def _stop(x, v, now, dt, lower, upper, stiffness, damping, hold):
    """Force of two stops, and by how much they stiffen the equations.

    Implicit in the motion as a spring is, so that a hard stop asks for no short step: the force
    is that without the step's acceleration, and what that changes stands with the mass.

    Args:
        x: Position at the beginning of the step.
        v: Velocity foreseen at its middle.
        now: Velocity at its beginning.
        dt: Step, s.
        lower: Where the lower stop begins.
        upper: Where the upper one begins.
        stiffness: Of both.
        damping: Of both.
        hold: What of a force is left that would hold the body back as it leaves.
    """
    stiff = 0.5 * dt * damping + 0.25 * dt * dt * stiffness
    share, deep = _touch(lower - x, -now, dt)
    if share > 0.0:
        left = 1.0 if stiffness * deep - share * damping * v > 0.0 else hold
        return left * (stiffness * deep - share * damping * now), left * share * stiff
    share, deep = _touch(x - upper, now, dt)
    if share > 0.0:
        left = 1.0 if -stiffness * deep - share * damping * v < 0.0 else hold
        return left * (-stiffness * deep - share * damping * now), left * share * stiff
    return 0.0, 0.0


@folded
def _load_joints(b, j, dt, bodies):
    """Add stops and damping of joints to the equations; a joint that is held is taken out."""
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    par, mass, force = bodies.joint, bodies.mass, bodies.force
    for i in range(n):
        p = first + i
        v = bodies.state[p, L.SJ_VELOCITY, j]
        push, stiff = _stop(
            bodies.state[p, L.SJ_POSITION, j],
            bodies.v[i],
            v,
            dt,
            par[p, L.PJ_LOWER, j],
            par[p, L.PJ_UPPER, j],
            par[p, L.PJ_STOP, j],
            par[p, L.PJ_STOP_DAMPING, j],
            par[p, L.PJ_HOLD, j],
        )
        damping, rate = par[p, L.PJ_DAMPING, j], par[p, L.PJ_SPRING, j]
        # implicit: the mean of a spring's force before and after is that at the mean position
        at = bodies.state[p, L.SJ_POSITION, j] + 0.5 * dt * v
        force[i] += push - damping * v - rate * (at - par[p, L.PJ_REST, j])
        mass[i, i] += stiff + 0.5 * dt * damping + 0.25 * dt * dt * rate


@folded
def _push(k, j, speed, now, dt, cylinders):
    """Force of gas, spring, stops and viscous friction on a piston, and by how much they stiffen.

    Args:
        k: Which cylinder.
        j: Which lane.
        speed: Foreseen at the middle of the step, m/s.
        now: At its beginning, m/s.
        dt: Step, s.
        cylinders: Cylinders.
    """
    par = cylinders.par
    # implicit: the mean of a spring's force before and after is that at the mean position
    at = cylinders.state[k, L.SY_EXTENSION, j] + 0.5 * dt * now
    push, stiff = _stop(
        cylinders.state[k, L.SY_EXTENSION, j],
        speed,
        now,
        dt,
        0.0,
        par[k, L.PY_STROKE, j],
        par[k, L.PY_STOP, j],
        par[k, L.PY_STOP_DAMPING, j],
        0.0,
    )
    rate, viscous = par[k, L.PY_SPRING, j], par[k, L.PY_VISCOUS, j]
    push += cylinders.state[k, L.SY_FORCE, j]
    push -= par[k, L.PY_PRELOAD, j] + rate * at + viscous * now
    stiff += 0.5 * dt * viscous + 0.25 * dt * dt * rate
    return push, stiff


@folded
def _load_cylinder(k, c, b, j, dt, bodies, cylinders):
    """Add gas, spring, stops and viscous friction of a cylinder to the equations of its body."""
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    lever = bodies.lever
    speed = now = 0.0
    for i in range(n):
        speed += lever[c, i] * bodies.v[i]
        now += lever[c, i] * bodies.state[first + i, L.SJ_VELOCITY, j]
    push, stiff = _push(k, j, speed, now, dt, cylinders)
    for i in range(n):
        bodies.force[i] += lever[c, i] * push
        if stiff > 0.0:
            for m in range(n):
                bodies.mass[i, m] += stiff * lever[c, i] * lever[c, m]


@folded
def _leave_behind(b, j, bodies, cylinders):
    """Take the mass of pistons that are loose out of that of their body, of which it is part.

    Its weight too, where that is the body's: on a rail.

    Args:
        b: Which body.
        j: Which lane.
        bodies: Bodies, with their mass and the levers of all places.
        cylinders: Cylinders.
    """
    n, place = bodies.table[b, L.B_JOINTS], bodies.table[b, L.B_PLACE]
    for c in range(bodies.table[b, L.B_PLACES]):
        k = bodies.driven_by[place + c]
        if cylinders.state[k, L.SY_SIDE, j] != 0.0 or not is_played(b, j, c, bodies):
            continue
        own = cylinders.par[k, L.PY_MASS, j]
        for i in range(n):
            square = bodies.lever[c, i] * bodies.lever[c, i]
            if square > 0.0:  # something is left of a body, whatever a file says
                own = min(own, MOST_LOOSE * bodies.mass[i, i] / square)
        if bodies.table[b, L.B_KIND] == RAIL:
            bodies.force[0] *= 1.0 - own / bodies.mass[0, 0]
        for i in range(n):
            for m in range(n):
                bodies.mass[i, m] -= own * bodies.lever[c, i] * bodies.lever[c, m]


@folded
def _take_out_held(b, j, bodies):
    """Leave joints that are held out of the equations."""
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    for i in range(n):
        if bodies.joint[first + i, L.PJ_HELD, j] > 0.0:
            for m in range(n):
                bodies.mass[i, m] = 0.0
                bodies.mass[m, i] = 0.0
            bodies.mass[i, i] = 1.0
            bodies.force[i] = 0.0


@folded
def _factor(n, mass):
    """Cholesky factor of the mass matrix, in its lower triangle."""
    for i in range(n):
        for m in range(i + 1):
            s = mass[i, m]
            for k in range(m):
                s -= mass[i, k] * mass[m, k]
            mass[i, m] = math.sqrt(s) if i == m else s / mass[m, m]


@folded
def _solve(n, factor, x):
    """Solve for a vector in place, by a Cholesky factor."""
    for i in range(n):
        s = x[i]
        for k in range(i):
            s -= factor[i, k] * x[k]
        x[i] = s / factor[i, i]
    for back in range(n):
        i = n - 1 - back
        s = x[i]
        for k in range(i + 1, n):
            s -= factor[k, i] * x[k]
        x[i] = s / factor[i, i]


@folded
def _grips(b, j, dt, played, bodies, cylinders):
    """Directions in which dry friction acts, and its most impulse; returns how many there are."""
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    place, places = bodies.table[b, L.B_PLACE], bodies.table[b, L.B_PLACES]
    rows = 0
    for c in range(places):
        bodies.row[c] = -1.0
        if played and bodies.loose[c] == LOOSE:
            continue
        k = bodies.driven_by[place + c]
        speed = 0.0
        for i in range(n):
            speed += bodies.lever[c, i] * bodies.state[first + i, L.SJ_VELOCITY, j]
        grip = _grip(k, j, speed, cylinders)
        if grip > 0.0:
            for i in range(n):
                held = bodies.joint[first + i, L.PJ_HELD, j] > 0.0
                bodies.along[rows, i] = 0.0 if held else bodies.lever[c, i]
            bodies.most[rows] = dt * grip
            bodies.soft[rows] = cylinders.par[k, L.PY_SOFT, j]
            bodies.damping[rows] = cylinders.par[k, L.PY_SOFT_DAMPING, j]
            bodies.bent[rows] = cylinders.state[k, L.SY_BENT, j]
            bodies.row[c] = rows
            rows += 1
    for i in range(n):
        grip = bodies.joint[first + i, L.PJ_FRICTION, j]
        if grip > 0.0 and bodies.joint[first + i, L.PJ_HELD, j] == 0.0:
            for m in range(n):
                bodies.along[rows, m] = 1.0 if m == i else 0.0
            bodies.most[rows] = dt * grip
            bodies.soft[rows] = 0.0
            rows += 1
    return rows


@folded
def _bend(speed, bent, most, dt, stiffness):
    """Deflection of a seal after a step at some speed, and by how much it grows with that.

    Backward Euler of the bristles of Canudas de Wit and others (1995), dz/dt = v - |v| z / z_most:
    z never exceeds what friction can hold.

    Args:
        speed: After the step.
        bent: Deflection before it.
        most: Greatest impulse of the friction in the step.
        dt: Step, s.
        stiffness: Force per deflection.
    """
    rate = dt * dt * stiffness / most
    below = 1.0 + rate * abs(speed)
    after = (bent + dt * speed) / below
    return after, (dt - math.copysign(rate, speed) * after) / below


@folded
def hold(free, give, most, bent, dt, soft, damping):
    """Impulse of dry friction along one direction.

    Args:
        free: Speed after the step without it.
        give: Speed per impulse.
        most: Greatest impulse while it slides.
        bent: Deflection of the seal before the step.
        dt: Step, s.
        soft: Deflection per force; 0 holds rigidly until it slides.
        damping: Force per rate of deflection.
    """
    if soft <= 0.0:
        return min(max(-free / give, -most), most)
    # The speed after the step decides (implicit), so that a stiff seal asks for no short step.
    stiffness = 1.0 / soft
    after, _ = _bend(free, bent, most, dt, stiffness)
    first = -dt * stiffness * after - damping * (after - bent)
    low, high = min(first, 0.0), max(first, 0.0)
    impulse = 0.5 * first
    for _ in range(HOLD_STEPS):
        after, growth = _bend(free + give * impulse, bent, most, dt, stiffness)
        wrong = impulse + dt * stiffness * after + damping * (after - bent)
        if wrong > 0.0:
            high = impulse
        else:
            low = impulse
        better = impulse - wrong / (1.0 + give * growth * (dt * stiffness + damping))
        if not low < better < high:
            better = 0.5 * (low + high)
        if abs(better - impulse) <= HELD * most:
            return better
        impulse = better
    return impulse


@folded
def hold_in_parts(before, free, give, grip, bent, dt, soft, damping):
    """Dry friction over a step so long that the speed may change its sign within it.

    Args:
        before: Speed before the step.
        free: Speed after it without friction; between them it is taken to change linearly.
        give: Speed per impulse.
        grip: Greatest friction.
        bent: Deflection of the seal before the step.
        dt: Step, s.
        soft: Deflection per force; 0 holds rigidly until it slides.
        damping: Force per rate of deflection.

    Returns:
        Impulse, speed and deflection after the step, and displacement.
    """
    part, change = dt / PARTS, (free - before) / PARTS
    speed, impulse, moved = before, 0.0, 0.0
    for _ in range(PARTS):
        push = hold(speed + change, give, part * grip, bent, part, soft, damping)
        new = speed + change + give * push
        moved += 0.5 * part * (speed + new)
        speed = new
        impulse += push
        if soft > 0.0:
            bent, _ = _bend(speed, bent, part * grip, part, 1.0 / soft)
    return impulse, speed, bent, moved


@folded
def _hold_back(n, rows, dt, bodies):
    """Impulses of dry friction, that take velocities along their directions away or fall short.

    ``bodies.v`` has the velocities without friction, and gets those with it.
    """
    for r in range(rows):
        for i in range(n):
            bodies.answer[r, i] = bodies.along[r, i]
        _solve(n, bodies.mass, bodies.answer[r])
        bodies.impulse[r] = 0.0
    for _ in range(2 if rows == 1 else SWEEPS):
        for r in range(rows):
            speed = give = 0.0
            for i in range(n):
                speed += bodies.along[r, i] * bodies.v[i]
                give += bodies.along[r, i] * bodies.answer[r, i]
            if give <= 0.0:
                continue
            old = bodies.impulse[r]
            new = hold(
                speed - give * old,
                give,
                bodies.most[r],
                bodies.bent[r],
                dt,
                bodies.soft[r],
                bodies.damping[r],
            )
            bodies.impulse[r] = new
            for i in range(n):
                bodies.v[i] += (new - old) * bodies.answer[r, i]


@folded
def _bend_seals(b, j, dt, bodies, cylinders):
    """Deflections of soft seals after a step, by the new velocities in ``bodies.v``."""
    n, places = bodies.table[b, L.B_JOINTS], bodies.table[b, L.B_PLACES]
    for c in range(places):
        r = int(bodies.row[c])
        if r < 0 or bodies.soft[r] <= 0.0:
            continue
        k = bodies.driven_by[bodies.table[b, L.B_PLACE] + c]
        speed = 0.0
        for i in range(n):
            speed += bodies.along[r, i] * bodies.v[i]
        cylinders.state[k, L.SY_BENT, j], _ = _bend(
            speed, bodies.bent[r], bodies.most[r], dt, 1.0 / bodies.soft[r]
        )


@folded
def _account(b, j, dt, rows, bodies):
    """Energy that dry friction and damping turn to heat in this step, J; ``bodies.v`` is new."""
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    heat = 0.0
    for r in range(rows):
        speed = 0.0
        for i in range(n):
            mean = 0.5 * (bodies.v[i] + bodies.state[first + i, L.SJ_VELOCITY, j])
            speed += bodies.along[r, i] * mean
        heat -= bodies.impulse[r] * speed
    for i in range(n):
        mean = 0.5 * (bodies.v[i] + bodies.state[first + i, L.SJ_VELOCITY, j])
        heat += dt * bodies.joint[first + i, L.PJ_DAMPING, j] * mean * mean
    return heat


@folded
def _let_go(b, j, dt, bodies, cylinders):
    """Note pistons whose face would have to hold them back: they are loose after this step.

    Args:
        b: Which body.
        j: Which lane.
        dt: Step, s.
        bodies: Bodies, with the levers at the middle of the step and the new velocities.
        cylinders: Cylinders.
    """
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    place, places = bodies.table[b, L.B_PLACE], bodies.table[b, L.B_PLACES]
    for c in range(places):
        if bodies.loose[c] != LEANS:
            continue
        k = bodies.driven_by[place + c]
        now = new = 0.0
        for i in range(n):
            now += bodies.lever[c, i] * bodies.state[first + i, L.SJ_VELOCITY, j]
            new += bodies.lever[c, i] * bodies.v[i]
        push, stiff = _push(k, j, 0.5 * (now + new), now, dt, cylinders)
        push -= (stiff + cylinders.par[k, L.PY_MASS, j]) * (new - now) / dt
        row = int(bodies.row[c])
        if row >= 0:
            push += bodies.impulse[row] / dt
        if push * cylinders.state[k, L.SY_SIDE, j] < 0.0:
            bodies.row[c] = LET_GO


@folded
def _move_loose(b, j, dt, bodies, cylinders):
    """Move loose pistons by a step, until they meet a face; returns what friction made, J.

    Args:
        b: Which body.
        j: Which lane.
        dt: Step, s.
        bodies: Bodies, moved, with extensions and levers at their new positions, which become those
            of the pistons as they lean.
        cylinders: Cylinders.
    """
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    place, places = bodies.table[b, L.B_PLACE], bodies.table[b, L.B_PLACES]
    par, state, heat = cylinders.par, cylinders.state, 0.0
    for c in range(places):
        if bodies.loose[c] != LOOSE:
            continue
        k = bodies.driven_by[place + c]
        now = state[k, L.SY_SPEED, j]
        push, stiff = _push(k, j, now + 0.5 * dt * state[k, L.SY_PUSH, j], now, dt, cylinders)
        give = 1.0 / (par[k, L.PY_MASS, j] + stiff)
        new = now + dt * push * give
        most = dt * _grip(k, j, now, cylinders)
        if most > 0.0:
            soft, bent = par[k, L.PY_SOFT, j], state[k, L.SY_BENT, j]
            damping = par[k, L.PY_SOFT_DAMPING, j]
            impulse = hold(new, give, most, bent, dt, soft, damping)
            new += give * impulse
            heat -= impulse * 0.5 * (now + new)
            if soft > 0.0:
                state[k, L.SY_BENT, j], _ = _bend(new, bent, most, dt, 1.0 / soft)
        at = state[k, L.SY_EXTENSION, j] + 0.5 * dt * (now + new)
        side = 1.0 if at > look_from(b, j, c, 1.0, bodies) else 0.0
        if side == 0.0 and at < look_from(b, j, c, -1.0, bodies):
            side = -1.0
        if side == 0.0:
            move = at - state[k, L.SY_EXTENSION, j]
            cylinders.work[k, L.WY_MOVE, j] = move
            state[k, L.SY_EXTENSION, j] = at
            state[k, L.SY_PUSH, j] = (new - now) / dt
            state[k, L.SY_SPEED, j] = new
            heat += par[k, L.PY_VISCOUS, j] * move * move / dt
            continue
        # it meets a face: an inelastic impact (scratch of the friction is free by now)
        give = 1.0 / par[k, L.PY_MASS, j]
        for i in range(n):
            held = bodies.joint[first + i, L.PJ_HELD, j] > 0.0
            bodies.along[0, i] = 0.0 if held else bodies.there_lever[c, i]
            bodies.answer[0, i] = bodies.along[0, i]
        _solve(n, bodies.mass, bodies.answer[0])
        apart = new
        for i in range(n):
            give += bodies.along[0, i] * bodies.answer[0, i]
            apart -= bodies.along[0, i] * bodies.v[i]
        if apart * side > 0.0:
            for i in range(n):
                bodies.v[i] += apart / give * bodies.answer[0, i]
                bodies.state[first + i, L.SJ_VELOCITY, j] = bodies.v[i]
        state[k, L.SY_SIDE, j] = side
    lean(b, j, bodies, cylinders)
    return heat


@folded
def _move_body(b, j, dt, bodies, cylinders):
    """One step of one body, and the ways of its pistons."""
    kind, first, n = (
        bodies.table[b, L.B_KIND],
        bodies.table[b, L.B_JOINT],
        bodies.table[b, L.B_JOINTS],
    )
    place, places = bodies.table[b, L.B_PLACE], bodies.table[b, L.B_PLACES]
    _middle(b, j, dt, bodies, 0.5)
    mechanics(kind, bodies.par, b, j, bodies.q, bodies.v, bodies.mass, bodies.force)
    levers(kind, bodies.par, b, j, bodies.q, bodies.x, bodies.lever)
    played = has_play(b, j, bodies)
    if played:
        _leave_behind(b, j, bodies, cylinders)
        lean(b, j, bodies, cylinders)
    _load_joints(b, j, dt, bodies)
    for c in range(places):
        if not (played and bodies.loose[c] == LOOSE):
            _load_cylinder(bodies.driven_by[place + c], c, b, j, dt, bodies, cylinders)
    _take_out_held(b, j, bodies)
    _factor(n, bodies.mass)
    _solve(n, bodies.mass, bodies.force)
    rows = _grips(b, j, dt, played, bodies, cylinders)
    for i in range(n):
        bodies.v[i] = bodies.state[first + i, L.SJ_VELOCITY, j] + dt * bodies.force[i]
    if rows > 0:
        _hold_back(n, rows, dt, bodies)
        _bend_seals(b, j, dt, bodies, cylinders)
    heat = _account(b, j, dt, rows, bodies)
    if played:
        _let_go(b, j, dt, bodies, cylinders)
    for i in range(n):
        old = bodies.state[first + i, L.SJ_VELOCITY, j]
        new = bodies.v[i]
        bodies.state[first + i, L.SJ_POSITION, j] += 0.5 * dt * (old + new)
        bodies.state[first + i, L.SJ_VELOCITY, j] = new
        bodies.state[first + i, L.SJ_PUSH, j] = (new - old) / dt
        bodies.q[i] = bodies.state[first + i, L.SJ_POSITION, j]
    levers(kind, bodies.par, b, j, bodies.q, bodies.x, bodies.lever)
    if played:
        heat += _move_loose(b, j, dt, bodies, cylinders)
    for c in range(places):
        k = bodies.driven_by[place + c]
        if played and bodies.loose[c] == LOOSE:
            continue
        was = cylinders.state[k, L.SY_EXTENSION, j]
        move = bodies.x[c] - was
        cylinders.work[k, L.WY_MOVE, j] = move
        cylinders.state[k, L.SY_EXTENSION, j] = bodies.x[c]
        speed = 0.0
        for i in range(n):
            speed += bodies.lever[c, i] * bodies.v[i]
        cylinders.state[k, L.SY_PUSH, j] = (speed - cylinders.state[k, L.SY_SPEED, j]) / dt
        cylinders.state[k, L.SY_SPEED, j] = speed
        heat += cylinders.par[k, L.PY_VISCOUS, j] * move * move / dt
        if played and bodies.row[c] == LET_GO:
            cylinders.state[k, L.SY_SIDE, j] = 0.0
    bodies.heat[b, j] += heat


@branching
def move(dt, bodies, cylinders):
    """Move every body by a step, and pistons that move none by what they are told.

    Args:
        dt: Step, s.
        bodies: Bodies.
        cylinders: Cylinders, with the forces of the gas.
    """
    for k in range(cylinders.table.shape[0]):
        if cylinders.moves[k] >= 0:
            continue
        for j in range(cylinders.work.shape[2]):
            way = dt * cylinders.state[k, L.SY_SPEED, j]
            cylinders.work[k, L.WY_MOVE, j] = way
            cylinders.state[k, L.SY_EXTENSION, j] += way
            cylinders.state[k, L.SY_PUSH, j] = 0.0
    for b in range(bodies.table.shape[0]):
        for j in range(bodies.state.shape[2]):
            _move_body(b, j, dt, bodies, cylinders)


@entry
def stand(bodies, cylinders):
    """Put pistons where the joints of their bodies have them.

    Args:
        bodies: Bodies.
        cylinders: Cylinders.
    """
    for b in range(bodies.table.shape[0]):
        first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
        place, places = bodies.table[b, L.B_PLACE], bodies.table[b, L.B_PLACES]
        for j in range(bodies.state.shape[2]):
            for i in range(n):
                bodies.q[i] = bodies.state[first + i, L.SJ_POSITION, j]
            levers(bodies.table[b, L.B_KIND], bodies.par, b, j, bodies.q, bodies.x, bodies.lever)
            played = has_play(b, j, bodies)
            if played:
                stay_within(b, j, bodies, cylinders)
            for c in range(places):
                k = bodies.driven_by[place + c]
                if played and bodies.loose[c] == LOOSE:
                    continue
                speed = 0.0
                for i in range(n):
                    speed += bodies.lever[c, i] * bodies.state[first + i, L.SJ_VELOCITY, j]
                cylinders.state[k, L.SY_EXTENSION, j] = bodies.x[c]
                cylinders.state[k, L.SY_SPEED, j] = speed
