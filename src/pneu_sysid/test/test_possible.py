# SPDX-License-Identifier: Apache-2.0
"""Rigs as they may be: drawn as a fit takes their numbers to be known."""

from pathlib import Path

import numpy as np

from pneu_sim.rig import load_rig
from pneu_sysid.curves import curve_ties, mirrors_of
from pneu_sysid.design.parameters import parameters_to_learn
from pneu_sysid.design.possible import possible_rigs
from pneu_sysid.fit import as_fitted
from pneu_sysid.parameters import variables_of

RIGS = Path(__file__).resolve().parents[3] / "rigs"
FEW = (
    "valves.valve.ports.supply.conductance_m3_s_pa",
    "pipes.tube.area_m2",
    "valves.valve.spool.bandwidth_hz",
)


def bare(name):
    rig = load_rig(RIGS / name)
    fit = rig.fit.model_copy(update={"parameters": []})
    return rig.model_copy(update={"calibration": None, "fit": fit})


def test_numbers_scatter_by_what_is_known_of_them():
    rig = as_fitted(bare("lab.yaml"))
    listed = [p for p in parameters_to_learn(bare("lab.yaml")) if p.path in FEW]
    assert len(listed) == len(FEW)
    drawn = possible_rigs(rig, listed, {}, 600, np.random.default_rng(1))
    for k, v in enumerate(variables_of(rig, listed)):
        x = np.array([variables_of(one.rig, listed)[k].value for one in drawn])
        assert abs(x.mean() - v.value) < 0.15 * v.std
        assert abs(x.std() - v.std) < 0.1 * v.std
        # what is known to a share is known to that share wherever the number is
        known = [variables_of(one.rig, one.parameters)[k].std for one in drawn]
        np.testing.assert_allclose(known, v.std, rtol=1e-9)


def test_curves_bend_no_more_than_a_fit_expects():
    """Points known to 70 % each, one for itself, would make curves that rise and fall."""
    start = bare("rig_b.yaml")
    rig = as_fitted(start)
    listed = parameters_to_learn(start)
    mirrors = mirrors_of(start)
    drawn = possible_rigs(rig, listed, mirrors, 60, np.random.default_rng(2))
    ties = curve_ties(rig, listed, mirrors)
    bends = []
    for one in drawn:
        for port in one.rig.valves["valve"].ports.values():
            opening = np.array(port.opening.fraction)
            rising = opening if opening[-1] > opening[0] else opening[::-1]
            assert np.all(np.diff(rising) > 0.0)
        x = np.array([v.value for v in variables_of(one.rig, listed)])
        bends.append(ties.matrix @ x - ties.right)
    # what the points themselves are known by takes a part of the freedom that the ties leave
    assert 0.6 < np.sqrt(np.mean(np.square(bends))) < 1.1


def test_what_was_calibrated_is_known_to_its_standard_error():
    rig = load_rig(RIGS / "rig_a_fitted.yaml")
    listed = [p for p in rig.fit.parameters if p.std_error is not None]
    drawn = possible_rigs(rig, listed, {}, 200, np.random.default_rng(3))
    (one,) = [p for p in listed if p.path == FEW[2]]
    assert one.std is not None and one.std_error is not None
    assert one.std_error < 0.1 * one.std
    found = [d.rig.valves["valve"].spool.bandwidth_hz for d in drawn]
    assert 0.8 * one.std_error < np.std(found) < 1.2 * one.std_error
    bandwidth_hz = rig.valves["valve"].spool.bandwidth_hz
    assert abs(np.mean(found) - bandwidth_hz) < 0.3 * one.std_error


def test_what_would_leave_its_bounds_stays_on_them():
    start = bare("lab.yaml")
    listed = parameters_to_learn(start)
    for one in possible_rigs(as_fitted(start), listed, {}, 40, np.random.default_rng(4)):
        for p, v in zip(listed, variables_of(one.rig, listed), strict=True):
            value = np.exp(v.value) if p.log else v.value
            assert p.lower * (1 - 1e-9) - 1e-15 <= value <= p.upper * (1 + 1e-9)
