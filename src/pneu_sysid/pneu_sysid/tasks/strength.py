# SPDX-License-Identifier: Apache-2.0
"""How strong the effect that was added last is, may be tried, and is made."""

from typing import Any

from pneu_common.errors import InputError
from pneu_sim.effects import find_effect
from pneu_sim.rig.schema import Rig
from pneu_sysid.parameter_units import strength_unit

REACH = 3.0
"""Strengths are tried up to so many times as far from where the effect vanishes."""


def range_of(rig: Rig) -> dict[str, Any]:
    """Strength of a rig's last effect, and the range in which it may be tried.

    Args:
        rig: The rig.

    Raises:
        InputError: It has no effect.
    """
    if not rig.effects:
        raise InputError(f"rig {rig.name!r}: effects: found none, one is tried at other strengths")
    added = rig.effects[-1]
    effect = find_effect(added.effect)
    strength = effect.strength
    low, high = effect.limits(strength, rig, added.place)
    now = added.parameters.get(strength.name, strength.absent)
    reach = REACH * (abs(now - strength.absent) or strength.typical)
    return {
        "strength": now,
        "lower": max(low, strength.absent - reach),
        "upper": min(high, strength.absent + reach),
        "absent": strength.absent,
        "title": effect.title,
        "unit": strength_unit(rig, effect, added.place),
    }


def with_strength(rig: Rig, strength: float) -> Rig:
    """A rig whose last effect is as strong as is said.

    Args:
        rig: The rig; it has an effect.
        strength: How strong.
    """
    last = rig.effects[-1]
    name = find_effect(last.effect).strength.name
    other = last.model_copy(update={"parameters": {**last.parameters, name: strength}})
    return rig.model_copy(update={"effects": [*rig.effects[:-1], other]})
