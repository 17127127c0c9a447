# SPDX-License-Identifier: Apache-2.0
"""Tables 2.2 to 2.4 of the thesis on a finger that slides and presses, known in full."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from pneu_common.errors import InputError
from pneu_sysid.contacts.estimate import Problem, State, estimate, parameters_of
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.tables import cross, leave_out, spread
from pneu_sysid.contacts.trajectories import begun


def beside(name: str) -> ModuleType:
    """A test module of this folder, for what it makes."""
    path = Path(__file__).with_name(f"{name}.py")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


finger = beside("test_contact_estimate")


@pytest.mark.long
def test_parameters_of_one_recording_do_on_another(tmp_path: Path) -> None:
    tracks = [finger.pressed(0.8, seed=seed)[0] for seed in (3, 4)]
    found = cross(finger.finger_scene(tmp_path), tracks, Physics(2))
    assert found.worst <= 1.4  # thesis, table 2.3: 1.39
    assert found.gain >= 1.7
    friction = found.labels.index("contact_friction@all")
    assert found.values[:, friction] == pytest.approx(finger.TRUE["friction"], rel=0.05)


def test_each_sensor_left_out_is_foretold(tmp_path: Path) -> None:
    track, _ = finger.pressed(0.8)
    loaded = finger.finger_scene(tmp_path, fitted=False, **finger.TRUE)
    (force,) = leave_out(loaded, [track], Physics(2), ["force"])
    assert force.with_it < force.rmse < 0.05 * force.span
    with pytest.raises(InputError, match=r"sensor 'torque' is none of x, z, force"):
        leave_out(loaded, [track], Physics(1), ["torque"])


@pytest.mark.long
def test_many_starts_end_alike(tmp_path: Path) -> None:
    track, _ = finger.pressed(0.6)
    found = spread(finger.finger_scene(tmp_path), [track], Physics(2), count=4, seed=1)
    friction = found.values[:, found.labels.index("contact_friction@all")]
    assert np.std(friction) < 0.03 * np.mean(friction)
    assert found.same == 1.0


@pytest.mark.long
def test_taking_turns_is_slower_than_together(tmp_path: Path) -> None:
    """2.3.2: trajectory and parameters in turns (EM) against one step of both."""
    track, _ = finger.pressed(0.6)
    loaded = finger.finger_scene(tmp_path)
    values, physics = loaded.scene.values, Physics(2)
    chains, q = begun(loaded, [track], values, physics)
    problem = Problem(loaded, chains, values, parameters_of(loaded, values), physics)
    start = State(q, problem.start())
    whole = estimate(problem, start, 50)
    turns, state, cost = 0, start, np.inf
    while turns < 4 * len(whole.history) and cost > 1.02 * whole.cost:
        state = estimate(problem, state, 1, parameters=False).state
        found = estimate(problem, state, 1, trajectory=False)
        state, cost = found.state, found.cost
        turns += 1
    assert turns >= 1.5 * (len(whole.history) - 1)
