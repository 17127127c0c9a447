# SPDX-License-Identifier: Apache-2.0
"""Stiff chambers, whose time constant is shorter than a step: pressure implicit in all flows.

Beside a port that is wide for it, or a pipe's end, a small chamber takes its new pressure in less
than a step. With the pressure of the step's beginning its ports would then swing, so the one at its
end is sought, for which mass and energy that flow in and out in the step are those it gains
(backward Euler). What leaves has the temperature that the gas has by then.
"""

from pneu_sim import layout as L
from pneu_sim.compiling import branching
from pneu_sim.kernel.ends import cushioned_state, face_state
from pneu_sim.kernel.leaks import leak_flow
from pneu_sim.kernel.ports import at_small, is_small, solve_port, through_port

SWEEPS, STEPS = 60, 80
FOUND = 1e-10
"""Share of the pressure to which it is found, and to which small chambers beside one another agree;
well above rounding, and what is left is made up for in the next step."""


@branching
def _gain(c, j, leaving, gas, order, cells, ends, ports, reservoirs, chambers, leaks):
    """Sum of the flows into a chamber, or out of it, at the pressure and temperature in its work.

    Args:
        c: The chamber.
        j: The lane.
        leaving: Whether what leaves is summed, else what enters.
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        cells: All slots.
        ends: Ends of pipes.
        ports: Ports.
        reservoirs: Reservoirs.
        chambers: Chambers.
        leaks: What leaks, a `Term`.

    Returns:
        Mass in kg/s, positive, and what that is times its stagnation temperature.
    """
    p, t = chambers.work[c, L.H_PRESSURE, j], chambers.work[c, L.H_TEMPERATURE, j]
    cp = gas.gamma * gas.r / (gas.gamma - 1.0)
    mass = heat = 0.0
    for k in range(ports.table.shape[0]):
        at_a = ports.table[k, L.P_A] == L.SIDE_CHAMBER and ports.table[k, L.P_AI] == c
        at_b = ports.table[k, L.P_B] == L.SIDE_CHAMBER and ports.table[k, L.P_BI] == c
        if at_a == at_b:
            continue
        m, warm = solve_port(k, j, gas, order, cells, ends, ports, reservoirs, chambers)
        if at_a:
            m = -m
        if (m < 0.0) == leaving:
            mass += abs(m)
            heat += abs(m) * warm
    for e in range(ends.table.shape[0]):
        if ends.table[e, L.E_KIND] == L.CHAMBER and ends.table[e, L.E_REF] == c:
            d, v, q = face_state(e, j, order, cells, ends)
            shut = chambers.work[c, L.H_SHUT, j]
            d, v, q = cushioned_state(d, v, q, p, t, shut, 0.0, gas.gamma, gas.r)
            m = d * v * cells.par[L.FACE, ends.table[e, L.E_FACE] * cells.lanes + j]
            if (m < 0.0) == leaving:
                mass += abs(m)
                heat += abs(m) * (q / (gas.r * d) + 0.5 * v * v / cp)
    for q in range(leaks.table.shape[0]):
        if leaks.table[q, L.K_SLOT] == -1 - c and leaks.par[q, L.LEAK_SIZE, j] > 0.0:
            m = -leak_flow(
                leaks.table[q, L.K_KIND],
                leaks.par[q, L.LEAK_SIZE, j],
                leaks.par[q, L.LEAK_SET, j],
                leaks.par[q, L.LEAK_RANGE, j],
                p,
                t,
                leaks.room[0, j],
                leaks.room[1, j],
                gas.gamma,
                gas.r,
            )
            if (m < 0.0) == leaving:
                mass += abs(m)
                heat += abs(m) * (t if leaving else leaks.room[1, j])
    return mass, heat


@branching
def _excess(c, j, p, dt, gas, order, cells, ends, ports, reservoirs, chambers, leaks):
    """Residual of a chamber's mass balance at a pressure, kg; sets the temperature of its energy.

    Energy gives the temperature: E' = E + dt cp (sum m T - out T'), and what is out is what was
    there, and came in, and is not there in the end.
    """
    cp = gas.gamma * gas.r / (gas.gamma - 1.0)
    volume, com = chambers.par[c, L.C_VOLUME, j], chambers.par[c, L.C_COMPLIANCE, j]
    rest = chambers.par[c, L.C_REST_P, j]
    now = p * (volume + com * (p - rest))
    energy = now / (gas.gamma - 1.0) + 0.5 * com * (p * p - rest * rest)
    held = chambers.state[c, 0, j]
    chambers.work[c, L.H_PRESSURE, j] = p
    into, heat = _gain(c, j, False, gas, order, cells, ends, ports, reservoirs, chambers, leaks)
    t = (chambers.state[c, 1, j] - energy + cp * (dt * heat + now / gas.r)) / (
        cp * (held + dt * into)
    )
    chambers.work[c, L.H_TEMPERATURE, j] = t
    out, _ = _gain(c, j, True, gas, order, cells, ends, ports, reservoirs, chambers, leaks)
    return now / (gas.r * t) - held - dt * (into - out)


@branching
def settle_small(gas, order, dt, cells, ends, ports, reservoirs, chambers, leaks):
    """Set pressure and temperature of small chambers to those at the end of the step, and flows.

    Args:
        gas: The gas.
        order: 1 Godunov, 2 MUSCL-Hancock.
        dt: Step, s.
        cells: All slots.
        ends: Ends of pipes, after `recall_ports`.
        ports: Ports.
        reservoirs: Reservoirs.
        chambers: Chambers.
        leaks: What leaks, a `Term`.
    """
    small = chambers.small
    for j in range(cells.lanes):
        count = 0
        for q in range(small.size):
            count += int(is_small(q, j, chambers))
        for _ in range(SWEEPS):
            moved = 0.0
            for q in range(small.size):
                if not is_small(q, j, chambers):
                    continue
                c = small[q]
                was = chambers.work[c, L.H_PRESSURE, j]
                low = high = was
                f = _excess(
                    c, j, was, dt, gas, order, cells, ends, ports, reservoirs, chambers, leaks
                )
                below = above = f
                # what it would hold grows with its pressure, what it gets falls: one root
                factor = 1.0 + 1e-6
                for _ in range(STEPS):
                    if below <= 0.0 <= above:
                        break
                    factor = factor * factor if factor < 4.0 else factor
                    if above < 0.0:
                        low, below = high, above
                        high *= factor
                        above = _excess(
                            c, j, high, dt, gas, order, cells, ends, ports, reservoirs, chambers,
                            leaks,
                        )  # fmt: skip
                    else:
                        high, above = low, below
                        low /= factor
                        below = _excess(
                            c, j, low, dt, gas, order, cells, ends, ports, reservoirs, chambers,
                            leaks,
                        )  # fmt: skip
                if not below <= 0.0 <= above:  # its gas is none that can be balanced
                    chambers.work[c, L.H_PRESSURE, j] = was
                    continue
                p = low if above - below <= 0.0 else low - below * (high - low) / (above - below)
                f_low, f_high = below, above
                for _ in range(STEPS):
                    f = _excess(
                        c, j, p, dt, gas, order, cells, ends, ports, reservoirs, chambers, leaks
                    )
                    if f > 0.0:  # regula falsi, its other end drawn in (Illinois)
                        high, f_high, f_low = p, f, 0.5 * f_low
                    else:
                        low, f_low, f_high = p, f, 0.5 * f_high
                    if high - low < FOUND * p or f == 0.0:
                        break
                    p = low - f_low * (high - low) / (f_high - f_low)
                    if not low <= p <= high:
                        p = 0.5 * (low + high)
                moved = max(moved, abs(p - was) / was)
            if count <= 1 or moved < FOUND * 10.0:
                break
        # what was balanced flows, whatever other ports will take
        for k in range(ports.table.shape[0]):
            if at_small(k, j, ports, chambers):
                through_port(k, j, gas, order, cells, ends, ports, reservoirs, chambers)


@branching
def keep_small(chambers):
    """Have pipes meet small chambers at the pressure that was found for them.

    Args:
        chambers: Chambers, after `settle_small`.
    """
    for q in range(chambers.small.size):
        for j in range(chambers.work.shape[2]):
            c = chambers.small[q]
            if is_small(q, j, chambers):
                chambers.work[c, L.H_MIDDLE, j] = chambers.work[c, L.H_PRESSURE, j]
