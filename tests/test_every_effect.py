# SPDX-License-Identifier: Apache-2.0
"""Every effect, and one of a user's own: what it declares is what it does.

`python -m studies.effects` writes the same figures down for people (docs/effects_proven.md).
"""

import dataclasses
import subprocess
import sys

import pytest
from tests.effect_benches import BENCHES, felt_on
from tests.references.effects import COMPARISONS

from pneu_common.errors import InputError
from pneu_sim.effects import load_effect_file, proof, registry
from pneu_sim.effects.registry import BUILT_IN
from pneu_sim.rig import Rig, load_rig
from pneu_sim.rig.build import build

pytestmark = pytest.mark.takes(25)

NAMES = [kind.name for kind in BUILT_IN]
OWN = "hot_stretch"
ELSEWHERE = {
    "end_cushion": "tests/test_effect_edges.py: a cushion of the rig's own, and throttles in series"
}
"""Effects that no closed form foretells, and the tests that compare them with something else."""


@pytest.fixture(scope="module")
def felt() -> dict[str, proof.At]:
    """Every effect where it is felt most, on the first rig on which it is felt."""
    load_effect_file("examples/my_effect.py")
    benches = {name: bench() for name, bench in BENCHES.items()}
    found = {}
    for name in [*NAMES, OWN]:
        order = [benches["short_arm"]] if name == "end_cushion" else list(benches.values())
        at = felt_on(registry()[name], order)
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
def test_what_holds_of_every_effect(felt: dict[str, proof.At], name: str) -> None:
    at = felt[name]
    others = [one for one in felt.values() if one.bench is at.bench]
    assert wrong(proof.prove(at, others, grids=False)) == []


@pytest.mark.long
@pytest.mark.parametrize("name", [*NAMES, OWN])
def test_no_effect_hangs_on_cells_or_steps(felt: dict[str, proof.At], name: str) -> None:
    assert wrong(proof.refines(felt[name])) == []


def test_a_user_s_effect_is_compared_with_what_it_foretells_itself(
    felt: dict[str, proof.At],
) -> None:
    (one,) = felt[OWN].effect.comparisons()
    found = proof.compare(felt[OWN].effect, one)
    assert len(found) == 3 and wrong(found) == []
    other = dataclasses.replace(one, expected=lambda excess_k: 1.02 * one.expected(excess_k))
    assert len(wrong(proof.compare(felt[OWN].effect, other))) == 3


@pytest.mark.parametrize("name", COMPARISONS)
def test_an_effect_is_what_its_reference_foretells(name: str) -> None:
    assert wrong(proof.compare(registry()[name], COMPARISONS[name])) == []


def test_every_effect_has_a_reference() -> None:
    assert set(COMPARISONS) | set(ELSEWHERE) == set(NAMES)
    assert not set(COMPARISONS) & set(ELSEWHERE)


@pytest.mark.parametrize(
    "bench", ["cart", *(pytest.param(n, marks=pytest.mark.long) for n in BENCHES if n != "cart")]
)
def test_what_nothing_tells_apart_is_declared(bench: str) -> None:
    declared = {(a, b) for a, effect in registry().items() for b in effect.same_as if a < b}
    found = proof.twins(BENCHES[bench]())
    assert found == (declared if bench == "cart" else set())


@pytest.mark.parametrize("model", ["thin_plate", "delay_line"])
def test_what_a_model_has_not_has_no_place_and_is_refused(model: str) -> None:
    rig = load_rig("rigs/rig_a.yaml").model_copy(update={"model": model})
    effect = registry()["local_loss"]
    assert effect.places(rig) and not effect.places_in(rig) and not list(effect.sites(rig))
    lossy = proof.attached(rig, "local_loss", "tube", {"K": 1.0, "position_m": 1.0})
    with pytest.raises(InputError, match=f"model '{model}' of rig 'rig_a' has nothing of it"):
        build(lossy)


def test_a_check_that_does_not_hold_says_so() -> None:
    """An effect that grows with the root of its strength, of which the order matters."""
    bench = BENCHES["line"]()
    gain = registry()["sensor_gain"]

    class Rooted(type(gain)):  # type: ignore[misc]
        name = "rooted"

        def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
            tap = rig.taps[place]
            tap.gain += values["error"] ** 0.5
            tap.bias_pa += 1e3 * tap.gain

    loaded = registry.__globals__["_loaded"]
    loaded["rooted"] = Rooted()
    try:
        at = proof.At(bench, loaded["rooted"], "end", {})
        other = proof.At(bench, gain, "end", {})
        said = wrong(proof.prove(at, [other], grids=False))
    finally:
        del loaded["rooted"]
    assert [one.partition(":")[0] for one in said] == ["vanishes", "slope", "order of attachment"]
    assert "with sensor_gain on end" in said[2]


def test_a_user_has_an_effect_proven_by_a_command() -> None:
    words = [sys.executable, "-m", "pneu_common.cli", "effects", "--effects"]
    words += ["examples/my_effect.py", "--prove", OWN]
    done = subprocess.run([*words, "--rig", "rigs/rig_a.yaml"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for said in ("vanishes", "slope", "cells half as long", "order of attachment", "reference"):
        assert said in done.stdout
    assert "FAILED" not in done.stdout
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr.strip().startswith("pneu: --prove: --rig is missing")
