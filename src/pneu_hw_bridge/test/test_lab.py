# SPDX-License-Identifier: Apache-2.0
"""The emulated lab as others see it: through its registers, its control port and its command."""

import base64
import hashlib
import json
import math
import signal
import socket
import statistics
import struct
import time
import zlib

import numpy as np
import pytest
from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException
from tests.robots import kokoro_lab
from typer.testing import CliRunner

from pneu_common.cli import build_app
from pneu_common.errors import InputError
from pneu_hw_bridge.lab.faults import KINDS
from pneu_hw_bridge.lab.sealed import open_sealed, read_effects, seal
from pneu_hw_bridge.modbus.bus import ModbusBus
from pneu_hw_bridge.registers.load import load_register_map
from pneu_sim.rig.load import load_rig
from pneu_sim.simulator import Simulator

pytestmark = [pytest.mark.realtime, pytest.mark.takes(20)]

TAPS = ["supply", "valve_out", "middle", "end", "exhaust"]


class Device:
    """A plain client, apart from the bridge's own."""

    def __init__(self, port):
        self.client = ModbusTcpClient("127.0.0.1", port=port, timeout=0.15, retries=0)
        assert self.client.connect()

    def read(self):
        reply = self.client.read_input_registers(0, count=10)
        assert not reply.isError(), reply
        values = struct.unpack(">5f", struct.pack(">10H", *reply.registers))
        return dict(zip(TAPS, values, strict=True))

    def write(self, volts):
        words = struct.unpack(">2H", struct.pack(">f", volts))
        return self.client.write_registers(100, list(words))

    def hold(self, volts, seconds):
        """Writes again and again, as the watchdog wants it."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            assert not self.write(volts).isError()
            time.sleep(0.01)


@pytest.fixture
def device(healthy_lab):
    one = Device(healthy_lab.port)
    yield one
    one.client.close()


def test_plant_responds_as_the_simulator(device, rig_file):
    """Filled for a time and held, the tube settles where an offline run of the rig does."""
    device.hold(0.0, 1.0)
    device.hold(6.0, 0.4)
    device.hold(5.0, 0.5)
    measured = statistics.mean(device.read()["end"] for _ in range(20) if device.write(5.0))
    rig = load_rig(rig_file)
    simulator = Simulator(rig, dx_m=0.1)
    simulator.run(1.0, {"voltage": 0.0})
    simulator.run(0.4, {"voltage": 6.0})
    offline = simulator.run(0.5, {"voltage": 5.0}).taps["end"][-1]
    risen = offline - rig.ambient.pressure_pa
    assert risen > 5e4
    assert measured - rig.ambient.pressure_pa == pytest.approx(risen, rel=0.1)


def test_time_is_real(device, lab):
    first = lab.ask("status")
    time.sleep(1.0)
    second = lab.ask("status")
    simulated = second["plant"]["time_s"] - first["plant"]["time_s"]
    passed = second["steady_s"] - first["steady_s"]
    assert simulated == pytest.approx(passed, abs=0.1)


def test_readings_have_the_rigs_noise_and_resolution(device):
    device.hold(0.0, 0.3)
    values = []
    for _ in range(200):
        values.append(device.read()["exhaust"])
        time.sleep(0.0015)
    assert np.std(values) == pytest.approx(250.0, rel=0.3)
    assert all(abs(value / 15.0 - round(value / 15.0)) < 1e-3 for value in values)


def test_own_watchdog_vents(device, lab, wait_until):
    device.hold(6.0, 0.2)
    assert lab.volts() == 6.0
    last_write = time.monotonic()
    wait_until(lambda: lab.volts() == 0.0, 1.0)
    change = lab.ask("history")["history"][-1]
    assert change["cause"] == "watchdog"
    assert change["steady_s"] - last_write < 0.15
    assert device.client.read_holding_registers(100, count=2).registers == [0, 0]
    assert lab.ask("status")["watchdog"]["tripped"]


def test_voltages_that_make_no_sense(device, lab):
    assert device.write(math.nan).isError()
    assert device.write(math.inf).isError()
    assert not device.write(25.0).isError()
    assert lab.volts() == 10.0
    device.write(0.0)


def test_registers_that_are_not_there(device):
    assert device.client.read_input_registers(5000, count=2).isError()
    assert device.client.write_registers(5000, [1]).isError()


# Faults


def test_fault_drop(device, lab, wait_until):
    lab.ask("fault", name="drop", seconds=0.3)
    with pytest.raises((ModbusException, OSError)):
        for _ in range(50):
            device.read()
            time.sleep(0.01)
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", lab.port), 0.1)

    def back():
        try:
            socket.create_connection(("127.0.0.1", lab.port), 0.1).close()
        except OSError:
            return False
        return True

    assert wait_until(back, 2.0) < 1.0


def test_fault_slow(device, lab):
    lab.ask("fault", name="slow", value=0.08)
    begun = time.monotonic()
    device.read()
    assert 0.08 <= time.monotonic() - begun < 0.15
    lab.ask("clear", name="slow")
    begun = time.monotonic()
    device.read()
    assert time.monotonic() - begun < 0.08


def test_fault_silent(device, lab):
    device.hold(0.0, 0.05)
    lab.ask("fault", name="silent")
    with pytest.raises(ModbusException):
        device.write(7.0)
    assert lab.volts() == 0.0, "what is not answered is not carried out either"
    with pytest.raises(ModbusException):
        device.read()


def test_fault_exception(device, lab):
    lab.ask("fault", name="exception", value=6)
    reply = device.client.read_input_registers(0, count=10)
    assert reply.isError() and reply.exception_code == 6
    assert device.write(7.0).isError()
    lab.ask("clear")
    assert not device.write(0.0).isError()


def test_fault_word_order(device, lab):
    right = device.read()
    lab.ask("fault", name="word_order")
    reply = device.client.read_input_registers(0, count=10).registers
    pairs = [(reply[i + 1], reply[i]) for i in range(0, 10, 2)]
    swapped = [struct.unpack(">f", struct.pack(">2H", *pair))[0] for pair in pairs]
    assert swapped == pytest.approx(list(right.values()), rel=0.05)
    assert device.read()["supply"] != pytest.approx(right["supply"], rel=0.05)


def test_fault_frozen(device, lab):
    lab.ask("fault", name="frozen", channel="end")
    values = []
    for _ in range(30):
        values.append(device.read())
        time.sleep(0.002)
    assert len({one["end"] for one in values}) == 1
    assert len({one["middle"] for one in values}) > 10


def test_fault_out_of_range(device, lab):
    lab.ask("fault", name="out_of_range", channel="middle", value=4e6)
    values = device.read()
    assert values["middle"] == 4e6
    assert values["end"] < 1e6


def test_fault_supply(device, lab):
    device.hold(0.0, 0.1)
    assert device.read()["supply"] > 6e5
    lab.ask("fault", name="supply", seconds=0.3)
    time.sleep(0.25)
    assert device.read()["supply"] < 1.5e5
    time.sleep(0.5)
    assert device.read()["supply"] > 5.5e5


def test_fault_malformed(device, lab):
    good = 0
    lab.ask("fault", name="malformed")
    for _ in range(10):
        try:
            device.client.connect()
            good += not device.client.read_input_registers(0, count=10).isError()
        except ModbusException:
            continue
    assert good == 0
    lab.ask("clear")
    device.client.close()
    assert device.client.connect()
    assert device.read()["supply"] > 0.0


@pytest.mark.long
def test_fault_jump_and_dead_valve(tmp_path):
    """At a robot: its encoder leaps, wrapped as it is, and one of its valves is left alone."""
    with kokoro_lab(tmp_path) as lab:
        device = Device(lab.port)
        elbow = load_register_map("kokoro_plc").encoders["elbow"]

        def counts():
            return device.client.read_input_registers(8, count=1).registers[0]

        def write(address, volts):
            words = list(struct.unpack(">2H", struct.pack(">f", volts)))
            return device.client.write_registers(address, words)

        before = counts()
        lab.ask("fault", name="jump", value=1.0)
        ahead = (counts() - before) % 16384
        assert ahead == pytest.approx(1.0 / elbow.scale, abs=20)
        lab.ask("fault", name="dead_valve", channel="rod")
        end_s = time.monotonic() + 0.5
        while time.monotonic() < end_s:
            assert not write(100, 5.0).isError()
            refused = write(110, 5.0)
            assert refused.isError() and refused.exception_code == 11
        assert lab.ask("status")["volts"] == {"head": 5.0, "rod": 0.0}
        lab.ask("clear")
        assert not write(110, 5.0).isError()
        assert lab.ask("status")["volts"]["rod"] == 5.0
        device.client.close()


def test_every_kind_of_fault_is_tested():
    tested = [name.removeprefix("test_fault_") for name in globals() if "test_fault_" in name]
    assert {one for name in tested for one in name.split("_and_")} == set(KINDS)


@pytest.mark.parametrize(
    ("details", "says"),
    [
        ({"name": "fire"}, "known are drop, slow"),
        ({"name": "slow", "channel": "end"}, "does not sit at a sensor"),
        ({"name": "frozen", "channel": "nose"}, "the device has supply"),
        ({"name": "slow", "seconds": -1.0}, "must be positive"),
        ({"name": "drop", "value": 3.0}, "has no number"),
        ({"name": "slow", "seconds": "long"}, "cannot be understood"),
    ],
)
def test_bad_faults_are_refused(healthy_lab, details, says):
    with pytest.raises(InputError, match=says):
        healthy_lab.ask("fault", **details)


def test_control_port_survives_nonsense(healthy_lab):
    for data in (b"\n", b"[1]\n", b"{\n", b"\xff\xfe\n", b"x" * 200_000 + b"\n"):
        with socket.create_connection(("127.0.0.1", healthy_lab.control_port), 2.0) as connection:
            try:
                connection.sendall(data)
                connection.shutdown(socket.SHUT_WR)
                connection.recv(4096)
            except OSError:
                continue  # what never ends is cut off
    assert healthy_lab.ask("status")["ok"]


# Start and end


def pneu(*arguments):
    """The command line, in this process: starting one takes seconds."""
    return CliRunner().invoke(build_app(), ["lab", *map(str, arguments)])


def test_other_addresses_than_loopback_need_a_flag(rig_file):
    result = pneu("--rig", rig_file, "--host", "0.0.0.0", "--port", "0")
    assert result.exit_code == 2
    assert "--expose" in result.stderr


def test_a_machine_too_slow_is_refused(rig_file):
    result = pneu("--rig", rig_file, "--dx", "0.002", "--port", "0", "--control-port", "0")
    assert result.exit_code == 2
    assert "times real time here" in result.stderr


def test_a_port_in_use_is_refused(lab, rig_file):
    result = pneu("--rig", rig_file, "--dx", "0.1", "--port", lab.port, "--control-port", "0")
    assert result.exit_code == 2
    assert f"cannot listen on 127.0.0.1:{lab.port}" in result.stderr


def test_commands_of_a_running_lab(healthy_lab):
    port = healthy_lab.control_port
    assert pneu("fault", "frozen", "--channel", "end", "--control-port", port).exit_code == 0
    shown = json.loads(pneu("status", "--control-port", port).stdout)
    assert shown["faults"] == ["frozen"]
    assert pneu("clear", "--control-port", port).exit_code == 0
    assert healthy_lab.ask("status")["faults"] == []
    assert "out_of_range" in pneu("fault").stdout
    refused = pneu("fault", "fire", "--control-port", port)
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)


@pytest.mark.long
def test_ends_on_a_signal_and_takes_its_ready_file_away(start_lab, tmp_path):
    with start_lab(tmp_path) as one:
        assert len(list(tmp_path.glob("ready*.json"))) == 1
        one.process.send_signal(signal.SIGINT)
        assert one.process.wait(5) == 0
        assert not list(tmp_path.glob("ready*.json"))


# Sealed effects

EFFECTS = "- {effect: leak, place: tube, parameters: {area_m2: 3.0e-7, position_m: 1.0}}\n"


def sealed_as(content: bytes) -> str:
    """A sealed file with some content, as if it had been sealed."""
    return json.dumps(
        {
            "pneu_sealed": 1,
            "sha256": hashlib.sha256(content).hexdigest(),
            "content": base64.b64encode(zlib.compress(content)).decode(),
        }
    )


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b'[{"effect": "gremlin", "place": "tube"}]', "0.effect: effect 'gremlin' is unknown"),
        (b'[{"effect": "leak", "place": "tube", "parameters": {"x": 1}}]', "found 'x', those of"),
        (b'[{"effect": "leak"}]', "0.place"),
        (b"not JSON", "the sealed content is no list of effects"),
        (b"[" * 100_000, "the sealed content is no list of effects"),
        (b"[" + b" " * (1 << 27) + b"]", "does not match its checksum"),
    ],
)
def test_what_is_sealed_and_means_nothing(tmp_path, rig_file, content, says):
    """By `reveal`, and by a lab that is given the file."""
    sealed = tmp_path / "odd.sealed.json"
    sealed.write_text(sealed_as(content))
    for words in (["reveal", sealed], ["--rig", rig_file, "--sealed", sealed]):
        done = pneu(*words)
        assert done.exit_code == 2
        assert done.stderr.startswith(f"pneu: {sealed}: ") and done.stderr.count("\n") == 1
        assert says in done.stderr


def test_a_sealed_file_that_is_cut_or_garbled(tmp_path):
    good = sealed_as(b'[{"effect": "leak", "place": "tube", "parameters": {}}]').encode()
    sealed = tmp_path / "odd.sealed.json"
    wrong = [good[:size] for size in range(0, len(good), 7)]
    wrong += [good[:at] + b"#" + good[at + 1 :] for at in range(2, len(good) - 1, 7)]
    wrong += [b"[" * 100_000, b"\xff\xfe", b"null", b'{"pneu_sealed": ' + b"9" * 5000 + b"}"]
    for content in wrong:
        sealed.write_bytes(content)
        done = pneu("reveal", sealed)
        assert done.exit_code == 2, content
        assert done.stderr.startswith(f"pneu: {sealed}: ") and done.stderr.count("\n") == 1


def test_what_cannot_be_is_not_sealed(tmp_path):
    plain, sealed = tmp_path / "effects.yaml", tmp_path / "sealed.json"
    plain.write_text("- {effect: gremlin, place: tube}")
    done = pneu("seal", plain, sealed)
    assert done.exit_code == 2 and "'gremlin' is unknown; known are" in done.stderr
    assert not sealed.exists()


@pytest.mark.long
def test_sealed_effects_act_and_do_not_show(start_lab, tmp_path):
    plain, sealed = tmp_path / "effects.yaml", tmp_path / "sealed.json"
    plain.write_text(EFFECTS)
    assert pneu("seal", plain, sealed).exit_code == 0
    for word in ("leak", "tube", "area"):
        assert word not in sealed.read_text()
    assert pneu("reveal", sealed).stdout == "leak@tube area_m2=3e-07, position_m=1\n"
    with start_lab(tmp_path, "--sealed", str(sealed)) as one:
        device = Device(one.port)
        device.hold(10.0, 0.6)
        filled = device.read()["end"]
        device.hold(5.0, 1.0)
        assert device.read()["end"] < filled - 2e4, "a tube that leaks does not hold"


def test_damaged_seals_are_refused(tmp_path):
    plain, sealed = tmp_path / "effects.yaml", tmp_path / "sealed.json"
    plain.write_text(EFFECTS)
    seal(read_effects(plain), sealed)
    assert open_sealed(sealed) == read_effects(plain)
    document = json.loads(sealed.read_text())
    for change, says in (
        ({"sha256": "0" * 64}, "checksum"),
        ({"content": "AAAA"}, "damaged"),
        ({"pneu_sealed": 2}, "found 2"),
    ):
        sealed.write_text(json.dumps({**document, **change}))
        with pytest.raises(InputError, match=says):
            open_sealed(sealed)
    plain.write_text("- {effekt: leak}\n")
    with pytest.raises(InputError, match="needed is a list of effect"):
        read_effects(plain)


# Profiles


@pytest.mark.long
def test_labjack_profile_against_the_lab(start_lab, tmp_path, wait_until):
    """The same bridge code on LabJack's addresses, scales and settings."""

    class Owner:
        volts, values, fault = 0.0, None, "not yet"

        def output(self, now_s):
            return {"voltage": self.volts}

        def readings(self, values, steady_s, stamp_ns):
            self.values = values

        def written(self, values, stamp_ns):
            pass

        def takes(self, mostly_s, usually_s):
            pass

        def bus(self, fault):
            self.fault = fault

    owner = Owner()
    with start_lab(tmp_path, "--registers", "labjack_t") as one:
        device = {"host": "127.0.0.1", "port": one.port}
        bus = ModbusBus(load_register_map("labjack_t", device), owner)
        bus.start()
        try:
            owner.volts = 7.5
            wait_until(lambda: one.volts() == 7.5)
            wait_until(lambda: owner.values and owner.values["end"] > 2e5)
            assert owner.values["supply"] == pytest.approx(6.2e5, abs=5e4)
            assert owner.fault == ""
            assert bus.vent().verified
        finally:
            bus.stop()
