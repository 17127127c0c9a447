# SPDX-License-Identifier: Apache-2.0
"""Rig files with numbers that no laboratory has: refused with the unit, and what was meant."""

from pathlib import Path

import pytest

from pneu_common.errors import InputError
from pneu_sim.rig import load_rig
from pneu_sim.rig.parameters import misfit

ROOT = Path(__file__).parents[3]
RIG = ROOT / "rigs" / "rig_a.yaml"


@pytest.mark.parametrize("path", sorted((ROOT / "rigs").glob("*.yaml")), ids=lambda p: p.stem)
def test_rigs_that_exist_are_believed(path: Path) -> None:
    rig = load_rig(path)
    assert misfit(rig) == ""


def load_changed(folder: Path, old: str, new: str):
    text = RIG.read_text(encoding="utf-8")
    assert old in text, f"{RIG.name} no longer contains {old!r}"
    file = folder / "changed.yaml"
    file.write_text(text.replace(old, new), encoding="utf-8")
    return load_rig(file)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("pressure_pa: 635000.0", "pressure_pa: 6.35", ("6.35 Pa", "6.35 bar are 635000 Pa")),
        ("pressure_pa: 635000.0", "pressure_pa: 635", ("635 Pa", "635 kPa are 635000 Pa")),
        ("temperature_k: 293.15", "temperature_k: 20", ("20 K", "20 °C are 293.15 K")),
        ("length_m: 2.5", "length_m: 2500", ("pipes.tube.length_m", "2500 mm are 2.5 m")),
        ("length_m: 2.5", "length_m: 250", ("pipes.tube.length_m", "250 mm are 0.25 m")),
        ("area_m2: 6.0e-6", "area_m2: 6", ("pipes.tube.area_m2", "6 mm2 are 6e-06 m2")),
        ("area_m2: 6.0e-6", "area_m2: 0.06", ("pipes.tube.area_m2", "0.06 cm2 are 6e-06 m2")),
        ("m3_s_pa: 0.9e-8", "m3_s_pa: 0.9", ("ports.supply.conductance", "0.9 dm3/(s bar) are")),
        ("length_m: 2.5", "length_m: true", ("pipes.tube.length_m", "a number is needed", "True")),
        ("length_m: 2.5", "length_m: .nan", ("pipes.tube.length_m", "found nan")),
        ("length_m: 2.5", "length_m: " + "9" * 5000, ("rig file", "thousands of digits")),
        ("length_m: 2.5", "length_m: " + "[" * 20000, ("nested too deeply",)),
        ("dx_m: 0.05", "dx_m: 1.0e-6", ("grid.dx_m",)),
        ("dx_m: 0.05", "dt_s: 1.0e-12", ("grid.dt_s", "1e-12 s")),
    ],
)
def test_what_no_laboratory_has_is_refused(
    tmp_path: Path, old: str, new: str, words: tuple[str, ...]
) -> None:
    with pytest.raises(InputError) as caught:
        load_changed(tmp_path, old, new)
    text = str(caught.value)
    assert "\n" not in text and "changed.yaml" in text
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{path: pipes.tub.area_m2, lower: 1.0e-6, upper: 1.0e-5}", "no 'tub' there"),
        ("{path: pipes.tube.area_m2, lower: 1.0e-9, upper: 1.0e-8}", "outside its bounds"),
        ("{path: chambers.*.volume_m3, lower: 1.0e-9, upper: 1.0e-8}", "nothing for '*'"),
        ("{path: name, lower: 0.0, upper: 1.0}", "a number is needed"),
    ],
)
def test_what_cannot_be_fitted_is_named(tmp_path: Path, entry: str, words: str) -> None:
    rig = load_changed(tmp_path, "warm_up_s: 0.4", f"parameters: [{entry}]")
    try:
        found = misfit(rig)
    except InputError as error:
        found = str(error)
    assert words in found
