# SPDX-License-Identifier: Apache-2.0
"""A Kokoro behind Modbus: bus and supervisor with a controller that swings its arm; its faults.

What goes wrong is brought about at the emulated lab, in a robot that moves as far as that matters.
"""

import time
from contextlib import contextmanager

from tests.bridges import ROOT, Rig, running_lab, wait_until
from tests.measured import MachineStalledError

from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.stops import stops_of
from pneu_sim.rig import load_rig

KOKORO = ROOT / "rigs" / "kokoro.yaml"
PLANT = ROOT / "rigs" / "lab_kokoro.yaml"
UP, DOWN = {"head": 8.5, "rod": 1.5}, {"head": 1.5, "rod": 8.5}
STOP = 0.8
"""Beyond that the arm is at a stop, rad."""
SEEN_S = 0.02
"""Readings further apart than this tell nothing of a jump: the machine was busy."""


@contextmanager
def kokoro_lab(folder, *options):
    """Runs a Kokoro behind Modbus, coarse enough for a busy machine."""
    plant = ("--rig", str(PLANT), "--registers", "kokoro_plc")
    with running_lab(folder, *plant, *options) as lab:
        yield lab


class KokoroRig(Rig):
    """Bus and supervisor of a Kokoro, with a controller that holds both valves open.

    Attributes:
        target: What it commands.
    """

    def __init__(self, lab, **encoder):
        """Prepares.

        Args:
            lab: The device.
            encoder: What the elbow's encoder has otherwise than in the register map.
        """
        self.lab, self.target = lab, DOWN
        registers = load_register_map("kokoro_plc", {"port": lab.port})
        elbow = registers.encoders["elbow"].model_copy(update=encoder)
        registers = registers.model_copy(update={"encoders": {"elbow": elbow}})
        self.set_up(registers, 0.002, stops=stops_of(load_rig(KOKORO)))

    def commands(self):
        return self.target

    def elbow(self):
        """Where the arm truly is, rad, and when that was asked for."""
        status = self.lab.ask("status")
        return status["encoders"]["elbow"], status["steady_s"]

    def rest_below(self):
        """Waits until the controller is followed and holds the arm at its lower stop."""
        self.target = DOWN
        wait_until(self.follows, 10.0)
        wait_until(lambda: self.elbow()[0] < -STOP, 10.0)
        time.sleep(0.4)


def controller_killed(rig):
    """The controller's last command; returns when."""
    rig.rest_below()
    rig.fall_silent()
    return time.monotonic()


def encoder_frozen(rig):
    """The encoder freezes while the arm swings up."""
    rig.rest_below()
    rig.target = UP
    wait_until(lambda: rig.elbow()[0] > -0.7, 5.0)
    begun_s = rig.lab.ask("fault", name="frozen", channel="elbow")["steady_s"]
    wait_until(lambda: not rig.follows(), 5.0)
    if abs(rig.link.report().readings["elbow"]) > STOP:
        raise MachineStalledError("the arm was at its other stop before the encoder froze")
    return begun_s


def encoder_jumps(rig):
    """The encoder suddenly reads more by a fifth of a turn."""
    rig.rest_below()
    before_s = time.monotonic()
    begun_s = rig.lab.ask("fault", name="jump", channel="elbow", value=1.3)["steady_s"]
    if begun_s - before_s > SEEN_S:
        raise MachineStalledError(f"the lab was asked for {begun_s - before_s:.3f} s")
    return begun_s


def encoder_beyond(rig):
    """The encoder reads more than the joint may have."""
    rig.rest_below()
    begun_s = rig.lab.ask("fault", name="out_of_range", channel="elbow", value=-1.1)["steady_s"]
    return begun_s


def joint_beyond(rig):
    """The arm swings past a limit that lies between its stops; needs ``upper=0.3``."""
    rig.rest_below()
    rig.target = UP
    passed_s = time.monotonic()
    while True:
        place, at_s = rig.elbow()
        if place > 0.3:
            return passed_s
        passed_s = at_s


def valve_dead(rig):
    """Nothing gets through to one of the valves any more."""
    rig.rest_below()
    return rig.lab.ask("fault", name="dead_valve", channel="rod")["steady_s"]


FAULTS = {
    "the controller is killed": (controller_killed, {}),
    "the encoder freezes": (encoder_frozen, {}),
    "the encoder jumps": (encoder_jumps, {}),
    "the encoder shows more than the joint may": (encoder_beyond, {}),
    "the joint swings beyond its limit": (joint_beyond, {"upper": 0.3}),
    "the bus to one valve is dead": (valve_dead, {}),
}
"""By name what brings a fault about, returning when, and what it needs of the encoder's limits."""
