# SPDX-License-Identifier: Apache-2.0
"""Hosts of a test's own, two at the ends of each cable, and cables that can be pulled.

Each host is a network namespace. Making one needs the right to; a test that asks for a cable where
there is none is skipped and says so.
"""

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import time

import pytest
from tests.bridges import wait_until

_NUMBERS = itertools.count()

PORT = 5020
ENDS = {"killed": signal.SIGKILL, "interrupted": signal.SIGINT, "silent": signal.SIGUSR1}
"""What a bridge may be sent whose cable is pulled."""

OLDEST_S = 0.15
"""A command that is older must not be applied."""

DEVICE = """
import socket, struct, sys, threading, time

written = open(sys.argv[1], "w", buffering=1)
outputs = bytearray(4)


def answer(request):
    function = request[0]
    if function == 16:
        outputs[:] = request[6:10]
        volts = struct.unpack(">f", outputs)[0]
        written.write(f"{time.monotonic()} {volts}\\n")
        return request[:5]
    count = struct.unpack(">H", request[3:5])[0]
    if function == 3:
        return bytes([function, 2 * count]) + (outputs + bytes(250))[: 2 * count]
    alive = 100.0 * (time.monotonic() % 1.0)  # (a sensor that never moves is dead)
    words = struct.pack(">5f", *(p + alive for p in (6e5, 3e5, 2.5e5, 2e5, 1e5)))
    return bytes([function, 2 * count]) + (words + bytes(250))[: 2 * count]


def serve(line):
    try:
        exchange(line)
    except OSError:  # it was cut, or its other end was killed
        return


def exchange(line):
    waiting = b""
    while got := line.recv(4096):
        waiting += got
        while len(waiting) >= 8:
            number, _, length, unit = struct.unpack(">HHHB", waiting[:7])
            if len(waiting) < 6 + length:
                break
            reply = answer(waiting[7 : 6 + length])
            waiting = waiting[6 + length :]
            line.sendall(struct.pack(">HHHB", number, 0, len(reply) + 1, unit) + reply)


listener = socket.create_server(("", int(sys.argv[2])))
while True:
    threading.Thread(target=serve, args=listener.accept()[:1], daemon=True).start()
"""

BRIDGE = """
import signal, sys, threading, time

from pneu_hw_bridge.link import Link
from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.safety.limits import limits_of
from pneu_hw_bridge.safety.supervisor import Supervisor

silent = threading.Event()
signal.signal(signal.SIGUSR1, lambda *_: silent.set())
signal.signal(signal.SIGINT, signal.default_int_handler)  # (a shell may have had it ignored)
registers = load_register_map("generic_plc", {"host": sys.argv[1], "port": int(sys.argv[2])})
link = Link(Supervisor(limits_of(registers)), lambda: None)
bus = ModbusBus(registers, link)
bus.start()
link.publishers(1)
link.enable(True)
try:
    while True:
        time.sleep(0.002)
        if not silent.is_set() and not link.command({"voltage": 5.5}):
            bus.poke()
except KeyboardInterrupt:
    link.enable(False)
    bus.vent()
    bus.stop()
"""


def opened(record, since_s=0.0):
    """When the device was told to open its valve, after a time."""
    lines = [line.split() for line in record.read_text().splitlines() if line.endswith("5.5")]
    return [float(at) for at, _ in lines if float(at) > since_s]


def _ip(*words):
    return subprocess.run(["ip", *words], capture_output=True, text=True, check=True)


class Cable:
    """Two hosts, `near` and `far`, and the cable between them."""

    def __init__(self):
        """Makes the hosts.

        Raises:
            OSError: There is no ``ip`` here.
            subprocess.CalledProcessError: Namespaces cannot be made here.
        """
        number = next(_NUMBERS)
        self.near, self.far = (f"pneu{os.getpid()}_{number}{end}" for end in "ab")
        self.address = f"10.77.{number}.2"
        self._processes = []
        _ip("netns", "add", self.near)
        try:
            _ip("netns", "add", self.far)
            cable = ("type", "veth", "peer", "name", "cable", "netns", self.far)
            _ip("link", "add", "cable", "netns", self.near, *cable)
            for host, end in ((self.near, 1), (self.far, 2)):
                _ip("-n", host, "addr", "add", f"10.77.{number}.{end}/24", "dev", "cable")
                _ip("-n", host, "link", "set", "lo", "up")
                _ip("-n", host, "link", "set", "cable", "up")
        except subprocess.CalledProcessError:
            self.close()
            raise

    def run(self, host, script, *arguments):
        """Runs Python code on a host until the cable is put away.

        Args:
            host: `near` or `far`.
            script: The code.
            *arguments: Its arguments.
        """
        command = ["ip", "netns", "exec", host, sys.executable, "-c", script, *map(str, arguments)]
        process = subprocess.Popen(command)
        self._processes.append(process)
        return process

    def pull(self):
        """Pulls the cable."""
        _ip("-n", self.far, "link", "set", "cable", "down")

    def plug(self):
        """Plugs it in again."""
        _ip("-n", self.far, "link", "set", "cable", "up")

    def close(self):
        """Ends what runs on the hosts, and removes them."""
        for process in self._processes:
            process.kill()
            process.wait()
        for host in (self.near, self.far):
            subprocess.run(["ip", "netns", "del", host], capture_output=True, check=False)


def new_cable():
    """Returns a cable between two new hosts; skips the test where there can be none."""
    try:
        return Cable()
    except OSError as error:
        pytest.skip(f"no network namespaces here: {error}")
    except subprocess.CalledProcessError as error:
        pytest.skip(f"no network namespaces here: {error.stderr.strip()}")


def pull_and_plug(folder, ends, pulled_s, afterwards_s):
    """Pulls cables, ends the bridge at each in its own way, and plugs them in again.

    Args:
        folder: For files.
        ends: The signal that each bridge gets, by name.
        pulled_s: For how long the cables are pulled, s.
        afterwards_s: For how long the devices are watched afterwards, s.

    Returns:
        By name when commands were applied that were older than they may be, steady times.
    """
    with contextlib.ExitStack() as at_the_end:
        cables, bridges = {}, {}
        for name in ends:
            cable = cables[name] = new_cable()
            at_the_end.callback(cable.close)
            cable.run(cable.far, DEVICE, folder / name, PORT)
            wait_until((folder / name).exists, 30.0)
            bridges[name] = cable.run(cable.near, BRIDGE, cable.address, PORT)
        for name in ends:
            wait_until(lambda name=name: opened(folder / name), 30.0)
        for cable in cables.values():
            cable.pull()
        since_s = time.monotonic()
        time.sleep(pulled_s)
        for name, number in ends.items():
            bridges[name].send_signal(number)
        time.sleep(0.5)
        for cable in cables.values():
            cable.plug()
        time.sleep(afterwards_s)
        return {name: opened(folder / name, since_s + OLDEST_S) for name in ends}
