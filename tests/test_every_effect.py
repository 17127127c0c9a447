# SPDX-License-Identifier: Apache-2.0
"""Verify every built-in effect and a user's example: common properties and reference results.

`make effects` writes the same deviations to docs/effects_proven.md.
"""

import dataclasses
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.effect_experiments import EXPERIMENTS, placement_on
from tests.references.effects import COMPARISONS

from pneu_common.errors import InputError
from pneu_sim.effects import load_effect_file, proof, registry
from pneu_sim.effects.registry import BUILT_IN, _loaded
from pneu_sim.rig import Rig, load_rig, save_rig
from pneu_sim.rig.build import build

pytestmark = pytest.mark.takes(25)

NAMES = [kind.name for kind in BUILT_IN]
OWN = "hot_stretch"


@pytest.fixture(scope="module", autouse=True)
def _with_the_example() -> Iterator[None]:
    """Registers the example for the tests of this file alone."""
    before = dict(registry())
    load_effect_file("examples/my_effect.py")
    yield
    _loaded.clear()
    _loaded.update(before)


@pytest.fixture(scope="module")
def placements() -> dict[str, proof.Placement]:
    """The placement of every effect on the first rig that responds to it."""
    experiments = {name: experiment() for name, experiment in EXPERIMENTS.items()}
    found = {}
    for name in [*NAMES, OWN]:
        order = [experiments["short_arm"]] if name == "end_cushion" else list(experiments.values())
        at = placement_on(registry()[name], order)
        assert at is not None, name
        found[name] = at
    return found


def wrong(findings: list[proof.Finding]) -> list[str]:
    """Those that do not hold, in words."""
    return [
        f"{one.check}: {one.deviation:.2g}, allowed {one.allowed:g} ({one.about})"
        for one in findings
        if not one.holds
    ]


@pytest.mark.parametrize("name", [*NAMES, OWN])
def test_what_holds_of_every_effect(placements: dict[str, proof.Placement], name: str) -> None:
    at = placements[name]
    others = [one for one in placements.values() if one.experiment is at.experiment]
    assert wrong(proof.prove(at, others, grids=False)) == []


@pytest.mark.long
@pytest.mark.parametrize("name", [*NAMES, OWN])
def test_no_effect_depends_on_cells_or_steps(
    placements: dict[str, proof.Placement], name: str
) -> None:
    assert wrong(proof.grid_independence(placements[name])) == []


def test_a_user_s_effect_is_compared_with_its_own_reference(
    placements: dict[str, proof.Placement],
) -> None:
    (one,) = placements[OWN].effect.comparisons()
    found = proof.compare(placements[OWN].effect, one)
    assert len(found) == 3 and wrong(found) == []
    other = dataclasses.replace(one, expected=lambda excess_k: 1.02 * one.expected(excess_k))
    assert len(wrong(proof.compare(placements[OWN].effect, other))) == 3


@pytest.mark.parametrize("name", COMPARISONS)
def test_an_effect_agrees_with_its_reference(name: str) -> None:
    assert wrong(proof.compare(registry()[name], COMPARISONS[name])) == []


def test_every_effect_has_a_reference() -> None:
    assert set(COMPARISONS) == set(NAMES)


@pytest.mark.parametrize(
    "experiment",
    ["cart", *(pytest.param(n, marks=pytest.mark.long) for n in EXPERIMENTS if n != "cart")],
)
def test_indistinguishable_pairs_are_declared(experiment: str) -> None:
    declared = {
        (a, b) for a, effect in registry().items() for b in effect.indistinguishable_from if a < b
    }
    found = proof.indistinguishable_pairs(EXPERIMENTS[experiment]())
    assert found == (declared if experiment == "cart" else set())


@pytest.mark.parametrize("model", ["thin_plate", "delay_line"])
def test_what_a_model_has_not_has_no_place_and_is_refused(model: str) -> None:
    rig = load_rig("rigs/rig_a.yaml").model_copy(update={"model": model})
    effect = registry()["local_loss"]
    assert effect.places(rig) and not effect.available_places(rig) and not list(effect.sites(rig))
    lossy = proof.attached(rig, "local_loss", "tube", {"K": 1.0, "position_m": 1.0})
    with pytest.raises(InputError, match=f"model '{model}' of rig 'rig_a' has nothing of it"):
        build(lossy)


def test_a_check_that_does_not_hold_says_so() -> None:
    """An effect that jumps at zero, is not linear, and depends on the order of attachment."""
    experiment = EXPERIMENTS["line"]()
    gain = registry()["sensor_gain"]

    class Rooted(type(gain)):  # type: ignore[misc]
        name = "rooted"

        def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
            tap = rig.taps[place]
            tap.gain += values["error"] ** 0.5
            tap.bias_pa += 1e3 * tap.gain

    _loaded["rooted"] = Rooted()
    try:
        at = proof.Placement(experiment, _loaded["rooted"], "end", {})
        other = proof.Placement(experiment, gain, "end", {})
        said = wrong(proof.prove(at, [other], grids=False))
    finally:
        del _loaded["rooted"]
    assert [one.partition(":")[0] for one in said] == ["vanishes", "slope", "order of attachment"]
    assert "with sensor_gain on end" in said[2]


def test_a_user_has_an_effect_proven_by_a_command(tmp_path: Path) -> None:
    rig = load_rig("rigs/rig_a.yaml")
    rig.grid.dx_m, rig.grid.memory = 0.25, False
    save_rig(rig, tmp_path / "coarse.yaml")
    words = [sys.executable, "-m", "pneu_common.cli", "effects", "--effects"]
    words += ["examples/my_effect.py", "--prove", OWN]
    done = subprocess.run(
        [*words, "--rig", tmp_path / "coarse.yaml"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    for said in ("vanishes", "slope", "cells half as long", "order of attachment", "reference"):
        assert said in done.stdout
    assert "FAILED" not in done.stdout
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.strip().startswith("pneu: --prove: --rig is missing")
