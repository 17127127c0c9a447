# SPDX-License-Identifier: Apache-2.0
"""Verdicts in words."""

from pneu_sim.effects.base import POSITION
from pneu_sysid.parameter_units import strength_unit
from pneu_sysid.refits import Refit
from pneu_sysid.standing import Standing


def nothing_missing(standing: Standing, left_times: float) -> str:
    """Nothing was found: of a change since the calibration, or of the noise.

    Args:
        standing: How the model stands to the recordings.
        left_times: Times the noise that would be left without what is uncertain anyway.
    """
    if standing.explains:
        return "Nothing is missing: the model explains the recording to the sensor noise."
    if standing.calibrated and not standing.own:
        return (
            "Nothing changed since the calibration: the model explains the recording as well as"
            " the one it was calibrated on."
        )
    return (
        f"No effect is missing: of the {standing.times_noise:.2f} times the noise that the model"
        f" leaves, {left_times:.2f} would be left if its base parameters were fitted here."
    )


def left_open(top: Refit) -> str:
    """The best candidate says no more than what the calibration left open.

    Args:
        top: It.
    """
    return (
        f"Nothing changed that the calibration knew: {top.site.label} would explain the error, but"
        " changes no number by more than two standard errors. To know them better:"
        f" {top.site.effect.next_experiment}"
    )


def strength_in_words(strength: float, std_error: float, unit: str) -> str:
    """A strength with its unit and standard error.

    Args:
        strength: The strength.
        std_error: Its standard error.
        unit: The unit.
    """
    return f"{strength:.3g} {unit}".strip() + f" (± {std_error:.1g})"


def _where(r: Refit) -> str:
    if r.position_error_m is not None:
        at = f"in {r.site.place} at {r.site.shape[POSITION]:.2f}"
        return f"{at} ± {r.position_error_m:.2f} m" if r.position_error_m < 10.0 else f"{at} m"
    return f"at {r.site.place}"


def missing(top: Refit, alike: list[str], alone: bool) -> str:
    """What is missing, where, and how much of it.

    Args:
        top: The best candidate.
        alike: Labels of those that it is not told from.
        alone: Whether it explains all that needs an explanation.
    """
    effect = top.site.effect
    unit = strength_unit(top.rig, effect, top.site.place)
    text = (
        f"Missing: {effect.title} {_where(top)},"
        f" {strength_in_words(top.strength, top.std_error, unit)}; it explains"
        f" {100.0 * top.held_out:.0f} % of the held-out squared residual"
    )
    if alike:
        text += f"; this recording cannot tell it from {', '.join(alike)}"
    if not alone:
        text += "; more is missing besides"
    return text + "."


def to_tell_apart(top: Refit) -> str:
    """What would tell the best candidate from those that are as good.

    Args:
        top: The best candidate.
    """
    return f"To tell {top.site.label} from the others: {top.site.effect.next_experiment}"


def unknown(
    top: Refit | None,
    depends_on: list[tuple[str, str, float]],
    seldom: list[tuple[str, float, float]],
) -> str:
    """Nothing in the catalogue explains it.

    Args:
        top: The nearest candidate; None where none is believed.
        depends_on: Variable, tap and gain of what the residual depends on.
        seldom: Recording, beginning and end of where it is, if it is almost nowhere else.
    """
    text = "Something is missing that the catalogue does not hold"
    if top is not None:
        text += (
            f" (the nearest, {top.site.label}, explains only {100.0 * top.held_out:.0f} % of the"
            " held-out squared residual)"
        )
    if depends_on:
        named = ", ".join(f"{v} at {tap}" for v, tap, _ in depends_on[:3])
        text += f"; the residual depends on {named}"
    if seldom:
        named = ", ".join(f"{begin:.1f} to {end:.1f} s of {name}" for name, begin, end in seldom)
        text += f"; most of it is at {named}"
    return text + "."
