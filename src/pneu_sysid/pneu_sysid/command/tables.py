# SPDX-License-Identifier: Apache-2.0
"""Tables of errors that several commands print."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from pneu_common.tables import Column, NamedTable

if TYPE_CHECKING:
    from pneu_sysid.results.learn import Step


def error_table(
    title: str, columns: dict[str, dict[str, float | None]], encoders: Mapping[str, str]
) -> NamedTable:
    """Errors per sensor side by side; the unit in the headings, or in a column where it differs.

    Args:
        title: Of the table.
        columns: Errors by sensor, per column.
        encoders: What the rig's encoders read.
    """
    from pneu_sysid.sensor_units import shared, unit_of

    sensors = list(next(iter(columns.values())))
    one = shared(encoders, sensors)
    heads = [Column(f"{name}, {one.told}" if one else name, "number") for name in columns]
    names = [Column("sensor" if encoders else "tap"), *([] if one else [Column("unit")])]
    table = NamedTable(title, [*names, *heads])
    for sensor in sensors:
        unit = unit_of(sensor, encoders)
        cells = [unit.figure(values.get(sensor)) for values in columns.values()]
        table.add_row(sensor, *([] if one else [unit.told]), *cells)
    return table


def step_table(steps: "list[Step]", encoders: Mapping[str, str]) -> NamedTable:
    """Errors after every added effect, held-out part, as a table.

    Args:
        steps: The steps.
        encoders: What the rig's encoders read.
    """
    from pneu_sysid.sensor_units import shared, unit_of

    sensors = list(steps[0].errors)
    one = shared(encoders, sensors)
    heads = sensors if one else [f"{s}, {unit_of(s, encoders).told}" for s in sensors]
    numbers = [Column(name, "number") for name in (*heads, "times noise")]
    table = NamedTable(
        f"held-out error per tap, {one.told}" if one else "held-out error per sensor",
        [Column("added"), Column("strength", "words"), *numbers],
    )
    for step in steps:
        name = "nothing yet" if step.added is None else f"{step.added}@{step.place}"
        strength = ""
        if step.strength is not None:
            strength = f"{step.strength:.3g} ± {step.std_error or 0.0:.1g} {step.unit}"
        table.add_row(
            name,
            strength,
            *(unit_of(name, encoders).figure(v) for name, v in step.errors.items()),
            "-" if step.held_out_times_noise is None else f"{step.held_out_times_noise:.2f}",
        )
    return table
