# SPDX-License-Identifier: Apache-2.0
"""How readings correct the gas: mass and energy grow with what the taps ask, by their spread."""

import numpy as np
import pytest
from tests.uncompiled import plain

from pneu_sim import kernel
from pneu_sim import layout as L
from pneu_sim.kernel import recording

ERROR_PA = np.array([[3e3, -8e3], [-5e3, 2e4], [7e3, 1.1e4]])
"""Of three taps in two lanes."""
SPREAD = np.array([[0.5, 0.2, 0.9], [-0.3, 0.8, 0.1]])
"""Of two slots or chambers, per tap."""
ASKED_PA = np.array(
    [
        [0.5 * 3e3 - 0.2 * 5e3 + 0.9 * 7e3, -0.5 * 8e3 + 0.2 * 2e4 + 0.9 * 1.1e4],
        [-0.3 * 3e3 - 0.8 * 5e3 + 0.1 * 7e3, 0.3 * 8e3 + 0.8 * 2e4 + 0.1 * 1.1e4],
    ]
)


def taps(spread_slot, spread_chamber, error_pa=ERROR_PA):
    """Three taps that ask for corrections."""
    none, lanes = np.zeros((3, 0, 2)), np.zeros((3, 2))
    return kernel.Taps(
        lanes.astype(np.int64), lanes, np.zeros((3, 2)).astype(np.int64), np.zeros((3, 2, 2)),
        np.zeros((3, L.SENSOR_ROWS, 2)), none, none, none,
        spread_slot, spread_chamber, lanes.astype(np.int64), lanes, lanes, error_pa, none,
    )  # fmt: skip


def chambers(pressure_pa):
    """Two chambers in two lanes, of distinct masses and energies."""
    work = np.full((2, L.CHAMBER_ROWS, 2), 1e3)
    work[:, L.H_PRESSURE] = pressure_pa
    state = np.array([[[1e-4, 2e-4], [20.0, 43.0]], [[5e-4, 3e-4], [110.0, 61.0]]])
    return kernel.Chambers(
        np.zeros((2, L.CHAMBER_PARAMS, 2)),
        state,
        work,
        np.zeros(0, dtype=np.int64),
        np.zeros((0, 2)),
    )


def test_chambers_are_corrected_by_what_all_taps_ask():
    pressure_pa = np.array([[2e5, 3e5], [5e5, 4e5]])
    held = chambers(pressure_pa)
    before = held.state.copy()
    plain(recording.correct_chambers)(held, taps(np.zeros((0, 3)), SPREAD))
    for row in (0, 1):  # mass and energy
        want = before[:, row] * (1.0 + ASKED_PA / pressure_pa)
        assert held.state[:, row] == pytest.approx(want, rel=1e-12)


def test_gas_in_lines_is_corrected_by_what_all_taps_ask():
    """Of four slots the first and the last are ghosts."""
    spread = np.array([[9.0] * 3, *SPREAD, [7.0] * 3])
    rows = (L.PARAM_ROWS, L.STATE_ROWS, L.WORK_ROWS, L.WALL_ROWS)
    par, state, work, wall = (np.zeros((n, 8)) for n in rows)
    par[L.INV_VOLUME] = [0.0, 0.0, 3.0, 3.0, 4.0, 4.0, 0.0, 0.0]
    state[:] = np.arange(1.0, 8 * L.STATE_ROWS + 1.0).reshape(state.shape)
    work[:], before = 1e3, state.copy()
    pressure_pa = np.array([1e5, 1e5, 2e5, 3e5, 5e5, 4e5, 1e5, 1e5])
    work[L.W_P] = pressure_pa
    cells = kernel.Cells(2, par, state, work, wall, np.zeros((L.SOFT_ROWS, 0)))
    plain(recording.correct)(cells, taps(spread, np.zeros((0, 3))))
    asked = np.zeros(8)
    asked[2:6] = ASKED_PA.ravel()
    moved = [L.RHO, L.MOM, L.ENE]
    assert state[moved] == pytest.approx(before[moved] * (1.0 + asked / pressure_pa), rel=1e-12)
    others = np.delete(np.arange(L.STATE_ROWS), moved)
    assert np.array_equal(state[others], before[others])


@pytest.mark.parametrize(("share", "left"), [(-0.49, 0.51), (-0.51, 0.5), (-3.0, 0.5), (2.0, 3.0)])
def test_a_correction_takes_at_most_half_of_the_gas(share, left):
    held = chambers(np.full((2, 2), 2e5))
    before = held.state.copy()
    only = np.array([[0.0, 0.0], [share * 2e5, 0.0], [0.0, 0.0]])
    plain(recording.correct_chambers)(held, taps(np.zeros((0, 3)), np.full((2, 3), 1.0), only))
    assert held.state[..., 0] == pytest.approx(left * before[..., 0], rel=1e-12)
    assert np.array_equal(held.state[..., 1], before[..., 1])
