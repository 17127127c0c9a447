# SPDX-License-Identifier: Apache-2.0
"""A rig that is wider as a whole has the same pressures, and an estimation that drifted is told."""

from pathlib import Path

import numpy as np
import pytest

import pneu_sim
from pneu_sim.rig import load_rig
from pneu_sim.rig.parameters import value_of
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sim.run import run_rig
from pneu_sysid.parameters import rig_at
from pneu_sysid.scale import off_scale, rescaled

TEE = Path(pneu_sim.__file__).parent / "rig" / "templates" / "tee.yaml"
FACTOR = 1.15
SMOOTH = dict.fromkeys(
    ("laminar", "turbulent", "unsteady", "nusselt", "heat_unsteady", "heat_turbulent"), 0.0
)


def _tee(smooth: bool) -> Rig:
    """A tee with two chambers, with or without friction and heat at its walls."""
    data = load_rig(TEE).dump()
    for pipe in data["pipes"].values():
        pipe["wall"] = {**pipe.get("wall", {}), **(SMOOTH if smooth else {})}
    for chamber in data["chambers"].values():
        chamber["heat_w_per_k"] = 0.02
    data.setdefault("grid", {})["wave_speed_m_s"] = 900.0
    return Rig.model_validate(data)


def _sizes(rig: Rig) -> list[FitParameter]:
    """Everything that grows with the scale, in logarithms but for the chambers' heat."""
    paths = [f"pipes.{n}.area_m2" for n in rig.pipes]
    paths += [
        f"chambers.{n}.{what}" for n in rig.chambers for what in ("volume_m3", "heat_w_per_k")
    ]
    paths += [
        f"valves.{v}.ports.{p}.conductance_m3_s_pa" for v in rig.valves for p in rig.valves[v].ports
    ]
    out = []
    for path in paths:
        value = value_of(rig, FitParameter(path=path, lower=0.0, upper=1.0))
        log = not path.endswith("heat_w_per_k")
        out.append(
            FitParameter(path=path, lower=0.2 * value, upper=5.0 * value, std=0.03 * value, log=log)
        )
    return out


def _values(rig: Rig, parameters: list[FitParameter]) -> np.ndarray:
    return np.array([np.log(v) if p.log else v for p in parameters for v in [value_of(rig, p)]])


@pytest.mark.parametrize("smooth", [True, False])
def test_pressures_hardly_tell_how_wide_a_rig_is(smooth: bool) -> None:
    """Without friction and heat in the lines not at all; with them by what the walls make of it."""
    rig = _tee(smooth)
    parameters = _sizes(rig)
    wider = rig_at(rig, parameters, rescaled(parameters, _values(rig, parameters), -np.log(FACTOR)))
    volts = {name: 5.0 + 0.4 * np.sign(np.sin(np.arange(300) / 17.0)) for name in rig.commands}
    one, other = (run_rig(r, volts, 2e-3) for r in (rig, wider))
    apart = max(float(np.max(np.abs(one[tap] - other[tap]))) for tap in one)
    assert apart < 1.0 if smooth else apart > 30.0, apart


def test_a_scale_that_drifted_is_told_in_deviations() -> None:
    """All sizes 10 % above what was known to 3 %: told as one factor, and gone when taken out."""
    rig = _tee(True)
    parameters = _sizes(rig)
    centres = _values(rig, parameters)
    drifted = rescaled(parameters, centres, -np.log(1.1))
    shift, deviations = off_scale(parameters, drifted, list(centres))
    sizes = len(rig.pipes) + len(rig.chambers)
    assert shift == pytest.approx(np.log(1.1), rel=1e-9)
    assert deviations == pytest.approx(np.log(1.1) / 0.03 * np.sqrt(sizes), rel=1e-9)
    back = rescaled(parameters, drifted, shift)
    assert off_scale(parameters, back, list(centres))[0] == pytest.approx(0.0, abs=1e-12)
    assert back == pytest.approx(centres)
