# SPDX-License-Identifier: Apache-2.0
"""Effects of a user's own: loading a file, applying it, one sentence where it is broken."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim import layout
from pneu_sim.effects import load_effect_file, registry
from pneu_sim.effects import registry as find_all
from pneu_sim.effects.registry import _loaded
from pneu_sim.rig import Rig, load_rig
from pneu_sim.rig.build import build
from pneu_sim.rig.schema import AttachedEffect

HOUSE = Path(__file__).parents[3]

GOOD = '''
from pneu_sim import layout
from pneu_sim.effects import Effect, EffectParameter


class ColdWall(Effect):
    """The wall of a pipe is colder than the room, and its area is smaller."""

    name = "cold_wall"
    title = "cold wall"
    formula = "T_wall = T_room - deficit_k"
    source = "a test"
    parameters = (EffectParameter("deficit_k", "K", 0.0, 0.0, 100.0, 20.0, 1.0),)
    next_experiment = "Warm it."

    def places(self, rig):
        return list(rig.pipes)

    def on_rig(self, rig, place, values):
        rig.pipes[place].area_m2 *= 1.0 - 1e-3 * values["deficit_k"]

    def on_model(self, model, rig, place, values):
        first, n = model.plan.pipes[place]
        model.cell[layout.WALL_T, first : first + n] -= values["deficit_k"]
'''


@pytest.fixture(autouse=True)
def forget_what_was_loaded() -> Iterator[None]:
    """Leaves the registry as it was."""
    before = registry()
    yield
    _loaded.clear()
    _loaded.update(before)


@pytest.fixture
def rig() -> Rig:
    return load_rig(HOUSE / "rigs" / "rig_a.yaml")


def attach(rig: Rig, effect: str, place: str, **parameters: float) -> Rig:
    copy = rig.model_copy(deep=True)
    copy.effects = [AttachedEffect(effect=effect, place=place, parameters=parameters)]
    return copy


def test_a_file_of_ones_own_acts_on_rig_and_model(rig: Rig, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(GOOD)
    assert load_effect_file(path) == ["cold_wall"]
    assert "cold_wall" in find_all()
    plain = build(rig)
    cold = build(attach(rig, "cold_wall", "tube", deficit_k=20.0))
    first, n = plain.plan.pipes["tube"]
    inside = slice(first, first + n)
    assert np.all(cold.cell[layout.WALL_T, inside] == 273.15)
    np.testing.assert_allclose(
        cold.cell[layout.AREA, inside], 0.98 * plain.cell[layout.AREA, inside]
    )
    outside = np.ones(plain.plan.slots, dtype=bool)
    outside[inside] = False
    assert np.all(cold.cell[layout.WALL_T, outside] == 293.15)
    assert load_effect_file(path) == ["cold_wall"]  # loading it again is no error


def test_the_example_warms_a_stretch_and_the_sealed_gas_in_it(rig: Rig) -> None:
    assert load_effect_file(HOUSE / "examples" / "my_effect.py") == ["hot_stretch"]
    hot = build(attach(rig, "hot_stretch", "tube", excess_k=40.0, position_m=1.0, length_m=0.33))
    plain = build(rig)
    excess = hot.cell[layout.WALL_T] - plain.cell[layout.WALL_T]
    first, n = plain.plan.pipes["tube"]
    dx = 2.5 / n
    assert excess.sum() * dx == pytest.approx(40.0 * 0.33)
    assert excess[first + round(1.0 / dx)] == pytest.approx(40.0)
    assert excess[first + n - 1] == 0.0


@pytest.mark.parametrize(
    ("source", "sentence"),
    [
        ("def broken(:\n", "SyntaxError"),
        ("raise ValueError('two\\nlines')\n", "ValueError: two lines"),
        ("import no_such_module_at_all\n", "ModuleNotFoundError"),
        ("from pneu_sim.effects import Effect\n", "defines no subclass of pneu_sim.effects.Effect"),
        (GOOD.replace('    name = "cold_wall"\n', ""), "ColdWall: attribute 'name' is missing"),
        (GOOD.replace("    source = ", "    origin = "), "attribute 'source' is missing"),
        (GOOD.replace("def on_rig", "def on_rigg"), "method 'on_rig' is missing"),
        (GOOD.replace('"cold_wall"', '"leak"'), "the name 'leak' is taken by a built-in effect"),
        (GOOD.replace("(EffectParameter", "(print"), "'parameters' must hold"),
        (GOOD.replace("0.0, 0.0, 100.0", "0.0, 5.0, 100.0"), "parameter 'deficit_k' needs"),
    ],
)
def test_broken_files_are_refused_in_one_sentence(
    tmp_path: Path, source: str, sentence: str
) -> None:
    path = tmp_path / "broken.py"
    path.write_text(source)
    known = set(registry())
    with pytest.raises(InputError) as caught:
        load_effect_file(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert sentence in message
    assert "\n" not in message
    assert set(registry()) == known


def test_missing_and_foreign_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such effects file"):
        load_effect_file(tmp_path / "nowhere.py")
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(InputError, match=r"ends in \.py"):
        load_effect_file(tmp_path / "notes.txt")
