# SPDX-License-Identifier: Apache-2.0
"""Flow of an ISO 6358 port between two lines, against the law solved by bisection."""

import math

import numpy as np
import pytest
from scipy.optimize import bisect

from pneu_sim.kernel.orifices import ANR_DENSITY, ANR_TEMPERATURE, iso6358_flow

CONDUCTANCE = 6e-9
RATIO = 0.3
AREA = 6e-6
SOUND = 343.0


def law(up: float, down: float, temperature: float, laminar: float, share: float) -> float:
    """Mass flow at the pressures at the port itself, as ISO 6358-1 and its linear range have it."""
    if down > up:
        return -law(down, up, temperature, laminar, share)
    sonic = CONDUCTANCE * up * ANR_DENSITY * math.sqrt(ANR_TEMPERATURE / temperature)

    def share_at(ratio: float) -> float:
        return math.sqrt(1.0 - (max(ratio - RATIO, 0.0) / (1.0 - RATIO)) ** 2)

    ratio = down / up
    if ratio > laminar:
        return sonic * share * share_at(laminar) * (1.0 - ratio) / (1.0 - laminar)
    return sonic * share_at(ratio)


@pytest.mark.parametrize("share", [1.0, 0.4])
@pytest.mark.parametrize("laminar", [1.0, 0.999, 0.95])
@pytest.mark.parametrize("lines", ["both", "none", "upstream", "downstream"])
def test_flow_and_pressures_at_the_port_agree(lines: str, laminar: float, share: float) -> None:
    z_a = SOUND / AREA if lines in ("both", "upstream") else 0.0
    z_b = SOUND / AREA if lines in ("both", "downstream") else 0.0
    p_a = 6e5
    for p_b in np.concatenate((np.linspace(1e5, 8e5, 57), p_a + np.linspace(-2e4, 2e4, 81))):
        found = iso6358_flow(p_a, z_a, 293.15, p_b, z_b, 293.15, CONDUCTANCE, RATIO, laminar, share)

        def too_much(m: float, p_b: float = p_b) -> float:
            return m - law(p_a - z_a * m, p_b + z_b * m, 293.15, laminar, share)

        # where a line has no pressure left, nothing more leaves it
        least, most = -p_b / max(z_b, 1e7), p_a / max(z_a, 1e7)
        wanted = bisect(too_much, 0.9999 * least, 0.9999 * most, xtol=1e-12)
        assert found == pytest.approx(wanted, rel=1e-6, abs=1e-10)


def test_where_the_flow_jumps_lines_hold_the_ratio_of_pressures() -> None:
    """Between what the linear range gives at its end and what comes after, it is the lines' say."""
    z, held = SOUND / AREA, 0
    flows = []
    for p_b in 6e5 - np.linspace(0.0, 1e5, 401):
        m = iso6358_flow(6e5, z, 293.15, p_b, z, 293.15, CONDUCTANCE, RATIO, 0.98, 0.4)
        held += (p_b + z * m) / (6e5 - z * m) == pytest.approx(0.98, abs=1e-9)
        flows.append(m)
    assert held > 20
    assert np.all(np.diff(flows) > 0.0)
    steps = np.diff(flows)
    assert steps.max() < 5.0 * np.median(steps), "a jump of the law is none of the flow"
