# SPDX-License-Identifier: Apache-2.0
"""What an experiment was expected to tell, beside what it told."""

from collections import Counter
from collections.abc import Iterable, Sequence

from pneu_sysid.design.plan import Plan
from pneu_sysid.diagnose import Diagnosis
from pneu_sysid.evidence import lead
from pneu_sysid.refits import Refit
from pneu_sysid.results.learn import Experiment, ToldApart


def judged(file: str, plan: Plan, found: Diagnosis) -> Experiment:
    """A plan that separates candidates, judged by the diagnosis that it helped.

    Args:
        file: The plan's.
        plan: It.
        found: The diagnosis, of all recordings together.
    """
    apart = []
    for one in plan.expected.separations:
        a, b = _refit(found, one.one), _refit(found, one.other)
        leads = None
        if a is not None and b is not None:
            leads = lead(a.residual, b.residual, found.bench.blocks, found.bench.doubtful)
        apart.append(
            ToldApart(
                one=one.one,
                other=one.other,
                expected=one.standard_errors,
                found=leads,
                needed=one.needed,
            )
        )
    return Experiment(
        plan=file, kind=plan.kind, seconds=plan.seconds, told_apart=apart, words=plan.expected.words
    )


def promised_errors(plan: Plan, paths: Sequence[str]) -> dict[str, float]:
    """Standard errors that a plan promised of parameters, by their paths.

    Args:
        plan: The plan.
        paths: Of what was fitted. Curves that a fit gave other points are left out: the same index
            is another voltage there.
    """
    errors = {path: x for path, x in plan.expected.std_errors.items() if x is not None}
    ours, theirs = _points(paths), _points(errors)
    return {
        path: errors[path]
        for path in paths
        if path in errors and ours.get(_curve(path)) == theirs.get(_curve(path))
    }


def _curve(path: str) -> str:
    """Path of the curve that a point is on; empty where it is on none."""
    curve, _, point = path.rpartition(".fraction.")
    return curve if point.isdigit() else ""


def _points(paths: Iterable[str]) -> Counter[str]:
    return Counter(curve for path in paths if (curve := _curve(path)))


def _refit(found: Diagnosis, label: str) -> Refit | None:
    """What was refitted of an effect at a place, wherever along a line."""
    effect, _, place = label.partition("@")
    part = effect, place.split(":")[0]
    return next((r for r in found.finalists if r.site.part == part), None)
