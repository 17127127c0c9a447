# SPDX-License-Identifier: Apache-2.0
"""An exact model leaves the noise and nothing else, whatever the rig's shape and the taps' rate.

The rigs are drawn at random and recorded by the simulator in one run from rest with steps of its
own; what is asked here is that times, starts and the pull to the taps add nothing to that.
"""

import numpy as np
import pytest
from studies.exact_rigs import RATES, SHAPES, draw_rig, record

from pneu_common.errors import InputError
from pneu_sim.rig import with_parameters
from pneu_sim.rig.schema import AttachedEffect, FitParameter, Rig
from pneu_sim.signals import Signal
from pneu_sysid.diagnose import diagnose, diagnose_apart
from pneu_sysid.fit import fit_rig
from pneu_sysid.problem import Problem, make_problem
from pneu_sysid.records import Recording
from pneu_sysid.together import each_of

SECONDS = 4.0
TOLERANCE = 0.10
SIGMAS = 3.0


def coarse(shape: str, rng: np.random.Generator) -> Rig:
    """A rig on longer cells, for what takes many runs; the step in time shows a little there."""
    rig = draw_rig(shape, rng)
    rig.grid.dx_m, rig.grid.memory = 0.1, False
    return rig


def times_noise(rig, recordings, **more) -> tuple[np.ndarray, np.ndarray]:
    """Error over noise per tap, and its scatter if it were noise alone."""
    problem = make_problem(rig, recordings, **more)
    residual = problem.residual(problem.predict([rig])[0])
    count = np.isfinite(problem.measured).sum(axis=(0, 1))
    return np.sqrt(np.sum(residual**2, axis=(0, 1)) / count), 1.0 / np.sqrt(2.0 * count)


@pytest.mark.long
@pytest.mark.parametrize(
    ("shape", "moving"), [("line", False), *((s, k % 2 == 0) for k, s in enumerate(SHAPES))]
)
def test_an_exact_model_leaves_the_noise(shape: str, moving: bool) -> None:
    """`make exact` has more of them."""
    rng = np.random.default_rng([SHAPES.index(shape), moving])
    rate = RATES[(2 * SHAPES.index(shape) + moving) % len(RATES)]
    rig = draw_rig(shape, rng)
    found, scatter = times_noise(rig, record(rig, rng, rate, SECONDS, moving))
    assert (found < 1.0 + TOLERANCE + SIGMAS * scatter).all(), (rate, found)
    assert (found > 1.0 - SIGMAS * scatter).all(), (rate, found)


@pytest.mark.long
def test_grids_of_readings_do_not_matter() -> None:
    """Taps at three rates and phases in one recording: each is predicted at its own times."""
    rng = np.random.default_rng(11)
    rig = draw_rig("tee", rng)
    whole = record(rig, rng, 500.0, SECONDS, moving=True)
    mixed = dict(whole.pressures)
    for k, tap in enumerate(list(mixed)[1:], start=2):
        signal = mixed[tap]
        mixed[tap] = Signal(signal.time_s[k :: 3 * k], signal.values[k :: 3 * k])
    found, scatter = times_noise(rig, Recording("mixed", whole.commands, mixed))
    assert (np.abs(found - 1.0) < 0.05 + SIGMAS * scatter).all(), found


@pytest.mark.long
def test_gaps_stay_gaps() -> None:
    rng = np.random.default_rng(12)
    rig = draw_rig("line", rng)
    whole = record(rig, rng, 125.0, SECONDS, moving=False)
    kept = {}
    for tap, signal in whole.pressures.items():
        keep = (signal.time_s < 2.0) | (signal.time_s > 2.8)
        kept[tap] = Signal(signal.time_s[keep], signal.values[keep])
    found, scatter = times_noise(rig, Recording("holed", whole.commands, kept))
    assert (np.abs(found - 1.0) < 0.05 + SIGMAS * scatter).all(), found


@pytest.mark.long
def test_sensors_are_taken_back_out_of_the_state() -> None:
    """A known gain, bias, lag and clock of a sensor do not fill the rig with wrong gas."""
    rng = np.random.default_rng(13)
    rig = draw_rig("two_valves", rng)
    for tap, values in zip(
        rig.taps.values(),
        ({"gain": 1.03}, {"bias_pa": 4e3}, {"lag_s": 8e-3}, {"offset_s": 5e-3}),
        strict=True,
    ):
        for name, value in values.items():
            setattr(tap, name, value)
    found, scatter = times_noise(rig, record(rig, rng, 250.0, SECONDS, moving=True))
    assert (np.abs(found - 1.0) < 0.05 + SIGMAS * scatter).all(), found


@pytest.mark.long
def test_models_run_together_are_those_run_alone() -> None:
    """Estimations in threads of their own share batches, and get what is theirs."""
    rng = np.random.default_rng(18)
    rig = draw_rig("line", rng)
    problem = make_problem(rig, record(rig, rng, 125.0, 2.0, moving=False))
    path = "valves.valve.spool.bandwidth_hz"
    rounds = [[50.0], [55.0, 60.0], [65.0, 70.0, 75.0]]  # of unlike lengths: some end earlier

    def estimate(shared: Problem, values: list[float]) -> list[np.ndarray]:
        return [shared.predict([with_parameters(rig, {path: v})])[0] for v in values]

    together = each_of(rounds, problem, estimate)
    for found, values in zip(together, rounds, strict=True):
        for one, alone in zip(found, estimate(problem, values), strict=True):
            # vectorised or not, by the place in a batch: equal but for the last bit
            np.testing.assert_allclose(one, alone, rtol=1e-12)

    def fail(shared: Problem, values: list[float]) -> None:
        if len(values) == 2:
            raise InputError("not this one")
        estimate(shared, values)

    with pytest.raises(InputError, match="not this one"):
        each_of(rounds, problem, fail)


@pytest.mark.long
def test_an_exact_model_is_not_accused_and_stays_where_it_is() -> None:
    rng = np.random.default_rng(15)
    rig = coarse("tee", rng)
    recording = record(rig, rng, 125.0, SECONDS, moving=True)
    parameters = [
        FitParameter(path="chambers.chamber_a.volume_m3", lower=1e-6, upper=2e-4, log=True),
        FitParameter(
            path="valves.valve.ports.supply.conductance_m3_s_pa", lower=1e-9, upper=5e-8, log=True
        ),
        FitParameter(path="valves.valve.ports.supply.critical_ratio", lower=0.02, upper=0.7),
        FitParameter(path="valves.valve.spool.bandwidth_hz", lower=20.0, upper=200.0, log=True),
    ]
    outcome = fit_rig(rig, recording, parameters=parameters, approach=False)
    values = np.array(outcome.estimate.values)
    truth = np.array(
        [np.log(s) if p.log else s for s, p in zip(outcome.start, parameters, strict=True)]
    )
    assert (np.abs(values - truth) < 4.0 * outcome.estimate.std_errors).all()
    calibrated = rig.model_copy(update={"calibration": outcome.rig.calibration})
    found = diagnose(calibrated, recording, finalists=2, refine=False)
    assert found.verdict == "nothing_missing", found.sentence
    assert found.standing.explains and "very recording" in found.statements[0]


@pytest.mark.long
def test_the_recording_that_differs_is_named() -> None:
    """A leak in one of four recordings: the verdict is of that one."""
    rng = np.random.default_rng(16)
    rig = coarse("line", rng)
    rig.fit.horizon_s = 0.5
    leak = AttachedEffect(
        effect="leak", place="tube", parameters={"area_m2": 2e-8, "position_m": 0.7}
    )
    leaking = rig.model_copy(update={"effects": [leak]})
    recordings = [
        record(leaking if k == 2 else rig, rng, 125.0, 4.0, moving=False, name=f"day_{k}")
        for k in range(4)
    ]
    healthy = fit_rig(
        rig,
        recordings[0],
        parameters=[FitParameter(path="reservoirs.supply.pressure_pa", lower=1e5, upper=2e6)],
        approach=False,
        iterations=1,
    ).rig
    found = diagnose_apart(healthy, recordings[1:], finalists=2, refine=False)
    assert found.verdict in ("effect", "ambiguous"), found.sentence
    assert found.finalists[0].site.effect.name == "leak"
    assert found.finalists[0].strength == pytest.approx(2e-8, rel=0.1)
    assert found.unchanged == ["day_1", "day_3"]
    assert "day_2" in found.statements[0] and "day_1, day_3" in found.statements[0]


@pytest.mark.long
def test_a_value_that_differs_from_recording_to_recording() -> None:
    """Two supplies: shared parameters from both, the supply once for each."""
    rng = np.random.default_rng(17)
    rig = coarse("line", rng)
    recordings = []
    for name, factor in (("low", 0.97), ("high", 1.02)):
        other = rig.model_copy(deep=True)
        other.reservoirs["supply"].pressure_pa *= factor
        recordings.append(record(other, rng, 125.0, 4.0, moving=False, name=name))
    supply = rig.reservoirs["supply"].pressure_pa
    outcome = fit_rig(
        rig,
        recordings,
        parameters=[
            FitParameter(path="reservoirs.supply.pressure_pa", lower=1e5, upper=2e6, each=True),
            FitParameter(path="valves.valve.spool.bandwidth_hz", lower=20.0, upper=200.0, log=True),
        ],
        approach=False,
    )
    fitted = outcome.rig.recordings
    assert fitted["low"]["reservoirs.supply.pressure_pa"] == pytest.approx(0.97 * supply, rel=1e-3)
    assert fitted["high"]["reservoirs.supply.pressure_pa"] == pytest.approx(1.02 * supply, rel=1e-3)
    found, _ = times_noise(outcome.rig, recordings)
    assert (found < 1.1).all(), found
