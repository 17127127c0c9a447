# SPDX-License-Identifier: Apache-2.0
"""Rows and columns of the kernels' arrays: numbered without gaps, and none more than are used."""

import pytest

from pneu_sim import layout as L

pytestmark = pytest.mark.kernel_free

TABLES = {
    "PARAM_ROWS": ("AREA", "LAMINAR"),
    "WORK_ROWS": ("W_U", "W_FE"),
    "WORK_ROWS_OF_SECOND": ("W_U", "W_IR"),
    "WALL_ROWS": ("D_PHI", "D_EXCESS"),
    "SOFT_ROWS": ("SOFT_STRETCH", "SOFT_FACE"),
    "END_COLUMNS": ("E_CELL", "E_REF"),
    "SIDE_COLUMNS": ("D_SLOT", "D_END"),
    "JOINT_ROWS": ("J_MASS", "J_PRESSURE"),
    "PORTED_ROWS": ("N_MASS", "N_ENTHALPY"),
    "PORT_COLUMNS": ("P_A", "P_MODE"),
    "PORT_PARAMS": ("Q_CONDUCTANCE", "Q_SHARE"),
    "REG_COLUMNS": ("REG_FILL", "REG_VENT"),
    "REG_PARAMS": ("REG_LOW", "REG_VENT_LEAK"),
    "REG_STATE": ("REG_SEEN", "REG_SUM"),
    "RESERVOIR_PARAMS": ("R_PRESSURE", "R_LOSS"),
    "RIPPLE_PARAMS": ("RIPPLE_AMPLITUDE", "RIPPLE_PHASE"),
    "TERM_COLUMNS": ("K_SLOT", "K_KIND"),
    "LEAK_PARAMS": ("LEAK_SIZE", "LEAK_RANGE"),
    "CHAMBER_PARAMS": ("C_VOLUME", "C_STIRRED"),
    "CHAMBER_ROWS": ("H_PRESSURE", "H_SHUT"),
    "CYLINDER_PARAMS": ("PY_AREA", "PY_HEADS_ROD"),
    "CYLINDER_STATE": ("SY_EXTENSION", "SY_BENT"),
    "CYLINDER_WORK": ("WY_SPEED", "WY_HEAT_ROD"),
    "BODY_COLUMNS": ("B_KIND", "B_PLACES"),
    "JOINT_PARAMS": ("PJ_DAMPING", "PJ_HOLD"),
    "JOINT_STATE": ("SJ_POSITION", "SJ_PUSH"),
    "SENSOR_ROWS": ("SENSE_KEEP", "SENSE_BIAS"),
}
"""Per count the first and the last of the numbers that it counts."""


@pytest.mark.parametrize("count", TABLES)
def test_numbers_of_a_table_are_its_rows(count):
    numbers = {name: of for name, of in vars(L).items() if isinstance(of, int)}
    names = [name for name in numbers if name not in TABLES]
    first, last = map(names.index, TABLES[count])
    assert [numbers[name] for name in names[first : last + 1]] == list(range(numbers[count]))


def test_rows_that_come_several_at_a_time():
    terms, side = L.UNSTEADY_TERMS, L.COLUMNS_PER_SIDE
    for numbers, first in (
        ((L.RHO, L.MOM, L.ENE, L.Y0), 0),
        ((L.Y_KIND, L.Y_REF, L.Y_CELLS, side), 0),
        ((L.Y_PORT, L.Y_PORT_ROD, L.CYLINDER_COLUMNS), 2 * side),
    ):
        assert list(numbers) == list(range(first, first + len(numbers)))
    assert terms == len(L.UNSTEADY_WEIGHTS)
    for number, before in ((L.Z0, L.Y0), (L.STATE_ROWS, L.Z0)):
        assert number == before + terms
