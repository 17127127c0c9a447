# SPDX-License-Identifier: Apache-2.0
"""Numbers of rig files as fields: shown in the units of people, stored in SI, checked."""

from pathlib import Path

import pytest

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_sim.init import TEMPLATES
from pneu_sim.rig import load_rig
from pneu_workbench.rig_fields import (
    UNITS,
    channels_of,
    checked,
    fields_of,
    shown_unit,
    with_number,
    with_value,
)

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted([*(ROOT / "rigs").glob("*.yaml"), *TEMPLATES.glob("*.yaml")])


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_a_form_that_nobody_touched_changes_nothing(path: Path) -> None:
    data = read_yaml(path, "rig file")
    fields = fields_of(data)
    assert fields
    again = data
    for field in fields:
        again = with_number(again, field, field.text)
    rig, fault = checked(again, path)
    assert fault == ""
    assert rig is not None and rig.dump() == load_rig(path).dump()
    assert len({field.keys for field in fields}) == len(fields)


def test_numbers_are_shown_in_the_units_of_people_and_stored_in_si() -> None:
    path = ROOT / "rigs" / "rig_a.yaml"
    data = read_yaml(path, "rig file")
    fields = {field.keys: field for field in fields_of(data)}
    length = fields["pipes", "tube", "length_m"]
    assert (length.text, length.unit) == ("2500", "mm")
    pressure = fields["reservoirs", "supply", "pressure_pa"]
    assert (pressure.text, pressure.unit) == ("6.35", "bar")
    # ISO 6358: 0.9e-8 m3/(s Pa) is 0.9 dm3/(s bar), or 54 l in a minute
    conductance = fields["valves", "valve", "ports", "supply", "conductance_m3_s_pa"]
    assert (conductance.text, conductance.unit) == ("54", "l/(min bar)")
    data = with_number(data, length, "2600,5")
    data = with_number(data, conductance, " 60 ")
    rig, fault = checked(data, path)
    assert fault == "" and rig is not None
    assert rig.pipes["tube"].length_m == pytest.approx(2.6005)
    assert rig.valves["valve"].ports["supply"].conductance_m3_s_pa == pytest.approx(1e-8)


def test_what_is_wrong_is_said_in_one_sentence() -> None:
    path = ROOT / "rigs" / "rig_a.yaml"
    data = read_yaml(path, "rig file")
    length = next(f for f in fields_of(data) if f.keys == ("pipes", "tube", "length_m"))
    for text in ("", "two", "1 2", "0x10"):
        with pytest.raises(InputError, match=r"pipes, tube: length: found .* a number is needed"):
            with_number(data, length, text)
    for text in ("-3", "0", "nan", "inf", "1e300"):
        rig, fault = checked(with_number(data, length, text), path)
        assert rig is None
        assert "length_m" in fault and "\n" not in fault and str(path) not in fault
    assert checked(data, path)[1] == ""  # it stays as it was


def test_channels_are_matched_by_hand() -> None:
    path = ROOT / "rigs" / "rig_a.yaml"
    data = read_yaml(path, "rig file")
    places = {words: keys for keys, words in channels_of(data)}
    assert {"command voltage", "tap end"} <= set(places)
    data = with_value(data, places["tap end"], {"column": "p4", "scale": 1e5})
    rig, fault = checked(data, path)
    assert fault == "" and rig is not None
    channel = rig.taps["end"].channel
    assert channel is not None and (channel.column, channel.scale) == ("p4", 1e5)
    assert checked(with_value(data, places["tap end"], {"scale": 0.0}), path)[0] is None
    without = with_value(data, places["tap end"], None)
    assert "channel" not in without["taps"]["end"]


def test_the_longest_end_of_a_name_says_the_unit() -> None:
    assert shown_unit("conductance_m3_s_pa") == UNITS["m^3/(s Pa)"]
    assert shown_unit("dead_volume_m3") == ("ml", 1e6)
    assert shown_unit("speed_m_s") == ("m/s", 1.0)
    assert shown_unit("damping") == ("", 1.0)
    assert shown_unit("inertia_kg_m2") == ("kg m²", 1.0)
    assert shown_unit("loss_to") == ("", 1.0)
