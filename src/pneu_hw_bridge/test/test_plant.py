# SPDX-License-Identifier: Apache-2.0
"""The plant of the emulated lab keeps the steady clock's time, however late its thread is."""

import time

import numpy as np
import pytest
from tests.bridges import wait_until
from tests.measured import MachineStalledError

from pneu_hw_bridge.lab.plant import Plant
from pneu_sim.rig.load import load_rig
from pneu_sim.simulator import Simulator

pytestmark = pytest.mark.realtime

LATENCY_S = 0.002
DX_M = 0.1


class Held(Plant):
    """A plant whose thread can be held up, as by a busy machine."""

    held_until_s = 0.0

    def _advance(self, samples, held):
        time.sleep(max(self.held_until_s - time.monotonic(), 0.0))
        super()._advance(samples, held)


@pytest.fixture
def plant(rig_file):
    rig = load_rig(rig_file)
    one = Held(rig, {"voltage": 5.0}, DX_M, latency_s=LATENCY_S, noise_pa=0.0, quantum_pa=0.0)
    one.start()
    yield one
    one.stop()


def read(plant, at_s):
    """The reading of a moment, waited for as the device does."""
    found = []

    def known():
        found[:] = [plant.readings(at_s)]
        return found[0] is not None

    wait_until(known, pause_s=0.001, alive=plant._thread.is_alive)
    return found[0]


def test_a_held_up_thread_changes_nothing(plant, rig_file):
    """Voltages act, and readings are taken, when they were asked for and not when there is time."""
    began_s = time.monotonic()
    plant.held_until_s = began_s + 0.3
    changes = [(5.0, 0.0)]
    asked = []
    for k, volts in enumerate((7.0, 4.5, 6.5, 5.0)):
        time.sleep(max(began_s + 0.01 + 0.05 * k - time.monotonic(), 0.0))
        before_s = time.monotonic()
        plant.apply({"voltage": volts})
        changes.append((volts, time.monotonic() - began_s))
        if began_s + changes[-1][1] - before_s > 1e-3:
            raise MachineStalledError("it is not known when the voltage changed")
        time.sleep(0.02)
        asked.append(time.monotonic())
    assert plant.readings(asked[-1]) is None, "not simulated yet, so not known"
    found = [read(plant, at_s)["end"] for at_s in asked]
    assert plant.status().worst_lag_s > 0.2
    assert plant.status().skipped_s == 0.0
    # The same offline, on a fine grid of time, up to a moment of rest before.
    step_s = 1e-4
    at = np.arange(round(0.3 / step_s)) * step_s
    held = np.full(at.size, 5.0)
    for volts, since_s in changes:
        held[at >= since_s] = volts
    offline = Simulator(load_rig(rig_file), dx_m=DX_M)
    taken = offline.run(at.size * step_s, {"voltage": held}, step_s)
    expected = [np.interp(t - began_s - LATENCY_S, taken.time_s, taken.taps["end"]) for t in asked]
    assert np.ptp(expected) > 5e4
    np.testing.assert_allclose(found, expected, atol=1500.0)


def test_time_that_cannot_be_caught_up_is_told(plant):
    plant.held_until_s = time.monotonic() + 2.4
    time.sleep(2.45)
    read(plant, time.monotonic())
    assert plant.status().skipped_s > 2.0
