# SPDX-License-Identifier: Apache-2.0
"""A cable that is pulled between bridge and device, and plugged in again: nothing old gets through.

The cables lie between network namespaces. Of those in which the bridge ends or falls silent while
its cable is out, without the bridge's care six in ten would open their valve for 0.1 s within 7 s.
"""

import signal
import time
from contextlib import ExitStack

from tests.cables import new_cable

PORT = 5020
PULLED_S, AFTERWARDS_S = 3.0, 5.0
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


def test_what_waited_for_the_cable_is_never_sent(tmp_path, wait_until):
    ends = {"killed": signal.SIGKILL, "interrupted": signal.SIGINT, "silent": signal.SIGUSR1}
    with ExitStack() as at_the_end:
        cables, bridges = {}, {}
        for name in ends:
            cable = cables[name] = new_cable()
            at_the_end.callback(cable.close)
            cable.run(cable.far, DEVICE, tmp_path / name, PORT)
            wait_until((tmp_path / name).exists, 20.0)
            bridges[name] = cable.run(cable.near, BRIDGE, cable.address, PORT)
        for name in ends:
            wait_until(lambda name=name: opened(tmp_path / name), 30.0)
        for cable in cables.values():
            cable.pull()
        pulled_s = time.monotonic()
        time.sleep(PULLED_S)
        for name, number in ends.items():
            bridges[name].send_signal(number)
        time.sleep(0.5)
        for cable in cables.values():
            cable.plug()
        time.sleep(AFTERWARDS_S)
        late = {name: opened(tmp_path / name, pulled_s + OLDEST_S) for name in ends}
        assert not any(late.values()), late
