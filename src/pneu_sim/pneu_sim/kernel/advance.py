# SPDX-License-Identifier: Apache-2.0
"""One step after another, many rigs at once: the passes in their order.

The quasi-one-dimensional Euler equations on a network, by finite volumes (thesis ch. 4 and 5). Each
pass is a plain loop over flat arrays, without Python objects, so that the same source can be
compiled for other targets. Everything that a step needs is passed in; nothing is allocated, and
nothing is kept from call to call but the arrays. How a run is cut into calls changes no bit of it.
"""

import functools
from collections.abc import Callable
from types import FunctionType
from typing import Any

from pneu_sim import layout as L
from pneu_sim.compiling import entry, sequence, uncached
from pneu_sim.kernel.bodies import foresee, move
from pneu_sim.kernel.chambers import find_chambers, find_middle, heat_chambers
from pneu_sim.kernel.encoders import correct_motion, read_encoders
from pneu_sim.kernel.ends import cross_ends, fill_ghosts, join, mirror_faces
from pneu_sim.kernel.faces import (
    close_outermost,
    cross,
    cross_steps,
    flatten_steps,
    reconstruct,
    taper,
)
from pneu_sim.kernel.leaks import jump_at_leaks
from pneu_sim.kernel.lines import (
    conserve,
    find_primitive,
    give_back,
    invert_density,
    take_gas,
    widen_faces,
    yield_half,
)
from pneu_sim.kernel.pistons import (
    fill_piston_ghosts,
    leak_past,
    make_room,
    open_cushions,
    press,
    reshape,
    settle,
    work_on_gas,
)
from pneu_sim.kernel.ports import cross_ports, open_ports, recall_ports
from pneu_sim.kernel.recording import (
    correct,
    correct_chambers,
    find_fastest,
    read,
    write_down,
    write_down_motion,
)
from pneu_sim.kernel.regulators import regulate_ports
from pneu_sim.kernel.reservoirs import supply
from pneu_sim.kernel.sides import jump_at_sides, mark_sides, press_sides, push_sides, soften_ends
from pneu_sim.kernel.small import keep_small, settle_small
from pneu_sim.kernel.terms import act as act_terms
from pneu_sim.kernel.terms import acting
from pneu_sim.kernel.walls import (
    act_steadily,
    drag_with_memory,
    find_coefficients,
    find_decay,
    heat_with_memory,
)

WALL_EVERY = 4
"""Drag ratio and decay follow density and Reynolds number, which change little within a few steps:
they are refreshed every so many, and at every sample, so that no cut of a run shows."""


@sequence
def _find_faces(gas, scheme, dt, cells, steps, sides, ends, leaks):
    """States on both sides of every face."""
    if scheme.order == 1:
        return
    reconstruct(gas, scheme.limiter == L.VAN_LEER, dt, cells)
    if scheme.tapered:
        taper(gas, dt, cells)
    if scheme.compliant:
        yield_half(gas, dt, cells)
    close_outermost(cells)
    flatten_steps(cells, steps)
    if sides.table.shape[0] > 0:
        jump_at_sides(scheme.limiter == L.VAN_LEER, dt, cells, sides)
    if leaks.table.shape[0] > 0:
        jump_at_leaks(scheme.limiter == L.VAN_LEER, dt, cells, leaks)
    mirror_faces(cells, ends)


@sequence
def _conserve(dt, scheme, cells, sides):
    """What the faces carry reaches the cells; where walls yield, what the pipe holds."""
    beside = sides.table.shape[0] > 0
    if scheme.compliant:
        give_back(cells)
        widen_faces(scheme.order, cells)
    if beside:
        mark_sides(cells, sides)
    if scheme.compliant:
        conserve(scheme.order, dt, cells, cells.soft[L.SOFT_FACE])
    else:
        conserve(scheme.order, dt, cells, cells.par[L.FACE])
    if beside:
        push_sides(cells, sides, True)


@sequence
def _act_of_walls(gas, scheme, dt, s, cells, sides):
    """Friction and heat of the walls, on the gas as it now is."""
    beside = sides.table.shape[0] > 0
    if scheme.compliant:
        take_gas(gas, cells)
        invert_density(cells)
    if s % WALL_EVERY == 0:
        find_coefficients(gas, cells)
        if scheme.memory:
            find_decay(gas, dt, cells)
    if beside:
        mark_sides(cells, sides)
    if scheme.memory:
        heat_with_memory(gas, scheme.order, dt, cells)
        drag_with_memory(scheme.order, dt, cells)
    else:
        act_steadily(gas, scheme.order, dt, cells)
    if beside:
        push_sides(cells, sides, False)
    if scheme.compliant:
        give_back(cells)


@entry
def advance(rigs, moving, clock, opening, record):
    """Advance a batch of rigs in place and record its taps.

    Args:
        rigs: The batch, a `Rigs`.
        moving: Its cylinders and bodies, a `Moving`; None has none, and the passes on them are then
            not compiled.
        clock: How many steps of what length, a `Clock`.
        opening: ((samples - 1) * (knots + 1), n_ports, lanes) opening fractions; both ends of an
            interval are its own.
        record: What is written down at every sample, a `Record`.
    """
    (
        gas,
        scheme,
        cells,
        steps,
        sides,
        ends,
        ports,
        reservoirs,
        chambers,
        terms,
        taps,
    ) = rigs
    dt, order = clock.dt, scheme.order
    # A pass is handed all that it works on, which takes as long as the gas of a few cells: those
    # that would find nothing are left out.
    beside = sides.table.shape[0] > 0
    if moving is not None:
        settle(cells, chambers, moving.cylinders)
    reading = taps.time.shape[1] > 0
    if moving is not None:
        reading = reading or moving.encoders.time.shape[1] > 0
    corrected = True  # the state may have been set
    for k in range(clock.samples):
        last = k == clock.samples - 1
        for s in range(clock.steps):
            step = k * clock.steps + s
            if scheme.compliant:
                take_gas(gas, cells)
            if scheme.compliant or corrected:  # else `conserve` has left it
                invert_density(cells)
            find_primitive(gas, cells)
            find_chambers(gas, chambers)
            if beside:
                soften_ends(dt, cells, sides, ends)
            corrected = shifted = False
            if reading and (clock.closing or not last):
                corrected = read(clock.watched + step, cells, chambers, taps)
                if moving is not None:
                    shifted = read_encoders(
                        clock.watched + step, moving.cylinders, moving.bodies, moving.encoders
                    )
            if s == 0:
                write_down(k, cells, ports, chambers, taps, record)
                if moving is not None:
                    write_down_motion(k, moving.cylinders, moving.bodies, record)
                if record.fastest.shape[0] > 0:
                    find_fastest(k, cells, record)
                if last:
                    if scheme.compliant:
                        give_back(cells)
                    break
            at = (s + 0.5) / clock.steps * clock.knots
            open_ports(k * (clock.knots + 1) + int(at), at - int(at), opening, ports)
            if moving is not None:
                open_cushions(ports, chambers, moving.cylinders)
                foresee(dt, moving.bodies, moving.cylinders)
            if ports.regulators.table.shape[0] > 0:
                regulate_ports(dt, cells, ends, ports, chambers)
            if reservoirs.ripple_of.size > 0:
                supply(step, dt, clock.lanes, reservoirs)
            if scheme.joints:
                join(gas, 1, cells, ends)
            vessels = order == 2 or s == clock.steps - 1 or reading
            fill_ghosts(gas, vessels, cells, ends, reservoirs, chambers)
            if moving is not None:
                fill_piston_ghosts(gas, cells, moving.cylinders)
            _find_faces(gas, scheme, dt, cells, steps, sides, ends, terms[0])
            if moving is not None:
                reshape(gas, scheme, dt, cells, moving.cylinders)
            cross(gas, scheme, cells)
            if beside:
                press_sides(cells, sides, ends)
                mark_sides(cells, sides)
            cross_steps(gas, scheme, dt, cells, steps)
            if scheme.joints and order == 2:
                join(gas, 2, cells, ends)
            recall_ports(cells, ends, ports)
            if chambers.small.size > 0:
                settle_small(gas, order, dt, cells, ends, ports, reservoirs, chambers, terms[0])
            cross_ports(gas, order, cells, ends, ports, reservoirs, chambers)
            find_middle(gas, order, dt, cells, ends, ports, chambers, moving)
            if chambers.small.size > 0:
                keep_small(chambers)
            cross_ends(gas, order, dt, cells, ends, ports, reservoirs, chambers)
            if moving is not None:
                press(gas, order, dt, cells, chambers, moving.cylinders)
                move(dt, moving.bodies, moving.cylinders)
                work_on_gas(dt, cells, chambers, moving.cylinders)
                leak_past(gas, dt, cells, chambers, moving.cylinders)
            if beside:
                push_sides(cells, sides, True)
            heat_chambers(gas, dt, chambers)
            act_terms(gas, dt, cells, chambers, terms)
            _conserve(dt, scheme, cells, sides)
            if moving is not None:
                make_room(gas, order, cells, chambers, moving.cylinders)
            _act_of_walls(gas, scheme, dt, s, cells, sides)
            if corrected:
                correct(cells, taps)
                correct_chambers(chambers, taps)
            if moving is not None and shifted:
                correct_motion(cells, chambers, moving.cylinders, moving.bodies, moving.encoders)


advance.sequence = True  # for the GPU, as `sequence` says of those that only kernels call


@functools.lru_cache(maxsize=16)
def advancing(terms: tuple[Callable[..., Any], ...]) -> Any:
    """`advance` with further terms, compiled for this process where there are any.

    The passes are those that are kept on disk; only their list is compiled.

    Args:
        terms: Compiled terms, see `pneu_sim.kernel.terms`.
    """
    if not terms:
        return advance
    own = advance.py_func
    scope = {**own.__globals__, "act_terms": acting(terms)}
    return uncached(FunctionType(own.__code__, scope, "advance_with_terms"))
