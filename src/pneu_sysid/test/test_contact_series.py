# SPDX-License-Identifier: Apache-2.0
"""Readings as functions of time, whose lag has a slope; and trajectories drawn to them."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.integrate import quad

from pneu_sysid.contacts.drawn import drawn
from pneu_sysid.contacts.knots import chain_of
from pneu_sysid.contacts.scene import load_scene
from pneu_sysid.contacts.track import Series, Track

SCENES = Path(__file__).resolve().parents[3] / "scenes"


def uneven(seed: int) -> Series:
    rng = np.random.default_rng(seed)
    return Series(np.cumsum(rng.uniform(0.0005, 0.002, 200)), rng.normal(size=(200, 3)))


def test_means_over_spans_are_those_of_the_lines_between_readings() -> None:
    series = uneven(1)
    first, last = series.time_s[[0, -1]]
    begin = np.array([first - 0.01, first - 0.001, 0.05, 0.1003, last - 0.001, last + 0.002])
    end = begin + np.array([0.004, 0.003, 0.0001, 0.02, 0.005, 0.001])
    found = series.mean_over(begin, end)
    for k, (a, b) in enumerate(zip(begin, end, strict=True)):
        inside = series.time_s[(series.time_s > a) & (series.time_s < b)]
        for column in range(3):
            whole = quad(
                lambda t, c=column: series.at(np.array([t]))[0, c], a, b, points=inside, limit=200
            )[0]
            assert found[k, column] == pytest.approx(whole / (b - a), abs=1e-9)


def test_means_change_with_a_span_as_its_ends_tell() -> None:
    series = uneven(2)
    begin, end = np.array([0.03, 0.0717]), np.array([0.033, 0.0732])
    step = 1e-8
    slope = series.mean_over(begin + step, end + step) - series.mean_over(begin - step, end - step)
    slope /= 2.0 * step
    rise = (series.at(end) - series.at(begin)) / (end - begin)[:, None]
    assert slope == pytest.approx(rise, rel=1e-4, abs=1e-2)


@pytest.mark.parametrize("omega_h", [0.5, 2.5, 9.0])
def test_a_spring_too_stiff_for_the_knots_does_not_run_away(omega_h: float) -> None:
    """A step of semi-implicit Euler longer than 2 / omega diverges, and there are finer ones."""
    loaded = load_scene(SCENES / "elbow.yaml")
    t = np.arange(0.0, 0.3, 0.005)
    still = np.tile([0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0], (len(t), 1))
    sensors = {
        "position": Series(t, still[:, :3] - np.outer(4.905 * t**2, [0.0, 0.0, 1.0])),
        "orientation": Series(t, still[:, 3:]),
        "elbow": Series(t, 0.2 + 0.1 * np.sin(20.0 * t)[:, None]),
    }
    setup = loaded.setup()
    model = setup.spec.compile()
    chain = chain_of(loaded, Track("falls", sensors), model)
    data = mujoco.MjData(model)
    data.qpos[:] = chain.start[0]
    mujoco.mj_forward(model, data)
    inverse = np.linalg.inv(_inertia(model, data))[-1, -1]  # of the hinge, all else free
    model.jnt_stiffness[-1] = (omega_h / np.diff(chain.time_s).max()) ** 2 / inverse
    q = drawn(chain, model, setup)
    assert np.isfinite(q).all()
    assert np.max(np.abs(q[:, -1])) < 0.5


def _inertia(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    return whole
