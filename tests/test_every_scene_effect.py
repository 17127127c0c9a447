# SPDX-License-Identifier: Apache-2.0
"""Verify every effect of scenes: reference results, and none at the value where it vanishes.

`make effects` writes the same deviations to docs/effects_proven.md.
"""

import numpy as np
import pytest
from tests.references.scenes import COMPARISONS, compare

from pneu_sysid.contacts.effects import scene_effects
from pneu_sysid.contacts.effects.base import Setup

EFFECTS = scene_effects()


def numbers(setup: Setup) -> dict[str, np.ndarray]:
    """All numbers of the compiled model."""
    model = setup.spec.compile()
    found = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    found |= {f"opt.{name}": getattr(model.opt, name) for name in ("gravity", "timestep")}
    return {n: np.array(a) for n, a in found.items() if isinstance(a, np.ndarray | float | int)}


def test_every_effect_has_a_reference() -> None:
    assert set(COMPARISONS) == set(EFFECTS)


@pytest.mark.parametrize("name", COMPARISONS)
def test_an_effect_agrees_with_its_reference(name: str) -> None:
    effect, one = EFFECTS[name], COMPARISONS[name]
    places = effect.places(one.setup(name, None))
    assert one.place in places
    assert all(effect.lower <= value <= effect.upper for value in one.values)
    assert effect.absent not in one.values
    found = compare(name)
    assert len(found) == len(one.values)
    assert [f"{f.about}: {f.deviation:.2g}" for f in found if not f.holds] == []


@pytest.mark.parametrize("name", [n for n, e in EFFECTS.items() if e.absent is not None])
def test_an_effect_vanishes(name: str) -> None:
    one, absent = COMPARISONS[name], EFFECTS[name].absent
    plain, vanished = one.setup(name, None), one.setup(name, absent)
    before, after = numbers(plain), numbers(vanished)
    assert set(before) == set(after) and len(before) > 300
    for key, value in before.items():
        np.testing.assert_array_equal(value, after[key], err_msg=key)
    if not EFFECTS[name].in_mjcf:
        np.testing.assert_array_equal(one.measure(plain), one.measure(vanished))
