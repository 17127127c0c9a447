# SPDX-License-Identifier: Apache-2.0
"""How a run of the gas is cut into calls changes no bit of it."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pneu_sim import layout as L
from pneu_sim import tile as tiles
from pneu_sim.effects import registry
from pneu_sim.rig import Rig, load_rig
from pneu_sim.rig.build import build
from pneu_sim.rig.schema import AttachedEffect
from pneu_sim.stepping import advance

RIGS = Path(__file__).parents[3] / "rigs"
SAMPLES, STEPS, KNOTS = 60, 5, 4  # five steps are no whole number of times between refreshed walls
DT_S = 6e-5


def rig_with(name: str, effect: str) -> Rig:
    rig = load_rig(RIGS / f"{name}.yaml")
    if effect == "none":
        return rig
    kind = registry()[effect]
    place, shape = next(iter(kind.sites(rig)))
    values = {kind.strength.name: kind.strength.typical, **shape}
    attached = AttachedEffect(effect=effect, place=place, parameters=values)
    return rig.model_copy(update={"effects": [*rig.effects, attached]})


CASES = [
    (name, effect)
    for name in ("rig_a", "rig_b_fitted", "ventilator", "closed_chamber")
    for effect in ("none", "supply_ripple", "wall_compliance", "relief_valve", "regulator_droop")
    if effect == "none" or registry()[effect].places(load_rig(RIGS / f"{name}.yaml"))
]


def filled(rig: Rig, rng: np.random.Generator, watched: bool) -> tuple[tiles.Tile, tiles.Watch]:
    """Two lanes of a rig, one pipe or chamber full, and readings that correct them."""
    models = [build(rig), build(rig)]
    tile = tiles.pack(models)
    slots = tile.plan.slots
    pressure = np.full((slots, 2), 1e5)
    pressure[: slots // 2] = 3e5, 2e5
    tiles.fill_pipes(tile, pressure, np.full((slots, 2), 293.0))
    chambers, taps = len(tile.plan.chambers), len(tile.plan.taps)
    tiles.fill_chambers(tile, np.full((chambers, 2), 2.5e5), np.full((chambers, 2), 293.0))
    tile.set_time(0.3)
    if not watched:
        return tile, tiles.unwatched(tile)
    time = np.sort(rng.uniform(0.0, SAMPLES * STEPS, (taps, 30, 2)), axis=1)
    sensor = np.zeros((taps, L.SENSOR_ROWS, 2))
    sensor[:, L.SENSE_KEEP], sensor[:, L.SENSE_NEW], sensor[:, L.SENSE_GAIN] = 0.5, 0.5, 1.0
    watch = tiles.Watch(
        time,
        rng.uniform(1e5, 3e5, time.shape),
        np.full(time.shape, 0.05),
        sensor,
        rng.uniform(0.0, 1.0, (slots, taps)),
        rng.uniform(0.0, 1.0, (chambers, taps)),
    )
    return tile, watch


@pytest.mark.parametrize("watched", [False, True])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("name", "effect"), CASES)
def test_a_run_cut_anywhere(name: str, effect: str, order: int, watched: bool) -> None:
    rig = rig_with(name, effect)
    rig = rig.model_copy(update={"grid": rig.grid.model_copy(update={"order": order})})
    seed = [len(name), len(effect), order, watched]
    whole, watch = filled(rig, np.random.default_rng(seed), watched)
    cut, cut_watch = filled(rig, np.random.default_rng(seed), watched)
    rng = np.random.default_rng(seed)
    ports = whole.plan.ports.shape[0]
    opening = rng.uniform(0.0, 1.0, (SAMPLES - 1, KNOTS + 1, ports, 2))
    at_once = advance(whole, STEPS, DT_S, opening, watch)
    where = [0, *np.sort(rng.choice(np.arange(1, SAMPLES - 1), 7, replace=False)), SAMPLES - 1]
    for first, last in pairwise(where):
        piece = advance(cut, STEPS, DT_S, opening[first:last], cut_watch, last == SAMPLES - 1)
        for name in ("taps", "flows", "chambers"):
            found, series = getattr(piece, name), getattr(at_once, name)
            assert np.array_equal(found, series[first : last + 1])
    assert np.ptp(at_once.taps) > 1e3  # it did move
    for kept in (*tiles.CHANGING, "time_s"):
        assert np.array_equal(getattr(cut, kept), getattr(whole, kept)), kept
    assert np.array_equal(cut_watch.readings, watch.readings, equal_nan=True)
