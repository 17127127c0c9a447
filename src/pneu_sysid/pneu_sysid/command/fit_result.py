# SPDX-License-Identifier: Apache-2.0
"""What a fit found, as the JSON result of ``pneu fit``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pneu_sysid.command.given import read_findings, titled

if TYPE_CHECKING:
    from pneu_sysid.design.plan import Plan
    from pneu_sysid.fit import FitOutcome
    from pneu_sysid.records import Recording
    from pneu_sysid.results.fit import FitResult


def fit_result(
    rig: str,
    output: str | None,
    recordings: "Sequence[Recording]",
    outcome: "FitOutcome",
    seconds: float | None = None,
    plan: "Plan | None" = None,
) -> "FitResult":
    """The JSON result of a fit.

    Args:
        rig: Rig file the fit started from.
        output: Rig file written.
        recordings: The recordings.
        outcome: The outcome.
        seconds: How long it took, s.
        plan: The plan that was played.
    """
    from pneu_common.installed import version
    from pneu_sysid.design.judge import promised_errors
    from pneu_sysid.parameter_units import unit_of_parameter
    from pneu_sysid.results.fit import Correlation, FitResult, FitShortfall, FittedParameter
    from pneu_sysid.sensor_units import encoder_units
    from pneu_sysid.uncertainty import pairs_above

    known = outcome.known
    promised = {} if plan is None else promised_errors(plan, [p.path for p in outcome.parameters])
    ranges = {} if plan is None else plan.expected.std_errors_range
    parameters = [
        FittedParameter(
            path=p.path,
            recording=p.recording,
            value=outcome.values[k],
            start=outcome.start[k],
            std_error=p.std_error,
            expected_error=promised.get(p.path),
            expected_range=ranges.get(p.path, []) if p.path in promised else [],
            unit=unit_of_parameter(outcome.rig, p.path),
            at_bound=bool(known.at_bound[k]),
            identified=bool(known.seen[k]),
            held=bool(known.held[k]),
            lower=p.lower,
            upper=p.upper,
        )
        for k, p in enumerate(outcome.parameters)
    ]
    names = [p.path for p in outcome.parameters]
    calibration = outcome.rig.calibration
    assert calibration is not None
    short = outcome.shortfall
    return FitResult(
        pneu_version=version(),
        recording=titled(recordings),
        recordings=[recording.name for recording in recordings],
        rigs=[outcome.rig.name],
        taps=list(outcome.rig.taps),
        encoders=encoder_units(outcome.rig),
        noise_floor_pa=dict(calibration.noise_floor_pa),
        noise_floor=dict(calibration.noise_floor),
        findings=read_findings(recordings),
        rig=rig,
        output=output,
        parameters=parameters,
        correlations=[
            Correlation(a=names[a], b=names[b], value=value)
            for a, b, value in pairs_above(known.correlation, 0.9)
        ],
        condition=known.condition,
        warnings=outcome.warnings,
        shortfall=None
        if short is None
        else FitShortfall(
            times_noise=dict(short.by_tap),
            sentence=short.sentence,
            where=short.where,
            help=short.help,
        ),
        rmse_pa=dict(calibration.rmse_pa),
        held_out_rmse_pa=dict(calibration.held_out_rmse_pa),
        rmse=dict(calibration.rmse),
        held_out_rmse=dict(calibration.held_out_rmse),
        history=list(outcome.estimate.history),
        seconds=seconds,
    )
