# SPDX-License-Identifier: Apache-2.0
"""Kinds of model: those of the package by name, and one of another distribution like them."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sim.full import Full
from pneu_sim.lumped.kinds import DelayLine, ThinPlate
from pneu_sim.models import ModelKind, kind_of
from pneu_sim.rig import Rig, load_rig
from pneu_sim.run import add_noise, run_rig
from pneu_sim.signals import Signal
from pneu_sim.simulator import Simulator
from pneu_sysid.compare import compare
from pneu_sysid.records import Recording

ROOT = Path(__file__).parents[1]
RIG_A = ROOT / "rigs" / "rig_a.yaml"


def installed(folder: Path, monkeypatch: pytest.MonkeyPatch, where: str) -> None:
    """A distribution with the example, as it lies on the path when it is installed."""
    shutil.copy(ROOT / "examples" / "my_model.py", folder)
    about = folder / "mine-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[pneu.models]\nfirst_order = {where}\n")
    monkeypatch.syspath_prepend(str(folder))


def rig_file(folder: Path, model: str) -> Path:
    text, count = re.subn(r"(?m)^name: (.*)$", rf"name: \1\nmodel: {model}", RIG_A.read_text())
    assert count == 1
    path = folder / "rig.yaml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "kind"), [("pde", Full), ("thin_plate", ThinPlate), ("delay_line", DelayLine)]
)
def test_kinds_of_the_package(name: str, kind: type[ModelKind]) -> None:
    rig = load_rig(RIG_A).model_copy(update={"model": name})
    assert type(kind_of(rig)) is kind
    assert kind_of(rig).along_lines == (name == "pde")


@pytest.mark.parametrize("name", ["thin_plate", "delay_line"])
def test_the_simulator_runs_the_model_that_is_named(name: str) -> None:
    rig = load_rig(RIG_A).model_copy(update={"model": name})
    volts = np.repeat(np.random.default_rng(3).uniform(3.0, 7.0, 25), 10)
    seen = Simulator(rig).run(0.002 * (volts.size - 1), {"voltage": volts}, 0.002).taps
    along = run_rig(rig, {"voltage": volts}, 0.002)
    for tap, series in along.items():
        # both follow the same openings, at steps of their own
        assert np.abs(seen[tap] - series).max() < 2e-3 * np.ptp(along["end"])
    with pytest.raises(InputError, match="knows no gas along its lines"):
        Simulator(rig).state("tube")


def test_a_kind_that_is_none_is_refused_with_those_that_are(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"model: .*'first_ordr'.*") as told:
        load_rig(rig_file(tmp_path, "first_ordr"))
    assert "pde, thin_plate, delay_line" in str(told.value)


def test_what_is_named_is_no_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed(tmp_path, monkeypatch, "my_model:TAU_S")
    rig = load_rig(rig_file(tmp_path, "first_order"))
    with pytest.raises(InputError, match="my_model:TAU_S is no subclass of ModelKind"):
        kind_of(rig)


def test_a_kind_of_another_distribution(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is run from rest, and compared with the full model on a recording of that."""
    installed(tmp_path, monkeypatch, "my_model:FirstOrder")
    own: Rig = load_rig(rig_file(tmp_path, "first_order"))
    sample_s = 2e-3
    volts = {"voltage": np.repeat([5.0, 7.0, 5.0, 3.0, 5.0], 150)}
    assert set(own.commands) == set(volts)
    found = run_rig(own, volts, sample_s)
    assert list(found) == list(own.taps)
    supply = max(r.pressure_pa for r in own.reservoirs.values())
    assert all(p.min() > 0.5e5 and p.max() <= supply for p in found.values())
    full = load_rig(RIG_A)
    time = sample_s * np.arange(volts["voltage"].size)
    true = run_rig(full, volts, sample_s)
    noisy = add_noise(full, true, np.random.default_rng(1), 200.0)
    recording = Recording(
        name="full",
        commands={name: Signal(time, v) for name, v in volts.items()},
        pressures={name: Signal(time, p) for name, p in noisy.items()},
    )
    compared = compare(recording, [("full", full, None), ("own", own, None)], refine=False)
    best, worse = compared.models
    assert best.times_noise < 1.1 < 10.0 < worse.times_noise
