# SPDX-License-Identifier: Apache-2.0
"""Bus and supervisor in front of a device, with a controller, and when the valves were safe."""

import os
import threading

from tests.measured import Watch

from pneu_hw_bridge.link import Link
from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.limits import limits_of
from pneu_hw_bridge.safety.supervisor import State, Supervisor


def watch(lab):
    """Judges times from now on; the bus runs in this process."""
    return Watch(lab, [lab.process.pid, os.getpid()])


class Rig:
    """Bus and supervisor with a controller that sends 500 commands a second."""

    def __init__(self, port, profile="generic_plc", period_s=0.002):
        registers = load_register_map(profile, {"port": port})
        self.link = Link(Supervisor(limits_of(registers)), lambda: None)
        self.bus = ModbusBus(registers, self.link, period_s)
        self.volts = 5.5
        self._silent = threading.Event()
        self._thread = threading.Thread(target=self._control, daemon=True)

    def __enter__(self):
        self.bus.start()
        self.link.publishers(1)
        self.link.enable(True)
        self._thread.start()
        return self

    def __exit__(self, *error):
        self._silent.set()
        self._thread.join(1.0)
        self.link.enable(False)
        self.bus.vent()
        self.bus.stop()

    def _control(self):
        while not self._silent.wait(0.002):
            if not self.link.command({"voltage": self.volts}):
                self.bus.poke()

    def fall_silent(self):
        """Has the controller send no more commands."""
        self._silent.set()

    @property
    def state(self):
        return self.link.report().state

    def follows(self):
        return self.state is State.FOLLOWING


def safe_since(lab):
    """When the valves got the safe voltage that they have kept from then on, and by whom."""
    changes = lab.ask("history")["history"]
    assert changes[-1]["volts"]["voltage"] == 0.0, changes[-3:]
    last = max(i for i, change in enumerate(changes) if change["volts"]["voltage"] != 0.0)
    return changes[last + 1]["steady_s"], changes[last + 1]["cause"]
