# SPDX-License-Identifier: Apache-2.0
"""The emulated lab as a whole: plant, device and control port, until a signal ends it."""

import asyncio
import ipaddress
import json
import logging
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.outputs import check_output
from pneu_hw_bridge.lab.asking import CONTROL_PORT, MODBUS_PORT
from pneu_hw_bridge.lab.control import Control
from pneu_hw_bridge.lab.device import LabDevice
from pneu_hw_bridge.lab.plant import Pace, Plant
from pneu_hw_bridge.lab.sealed import open_sealed
from pneu_hw_bridge.priority import precedence
from pneu_hw_bridge.registers.load import load_register_map
from pneu_hw_bridge.registers.schema import RegisterMap
from pneu_sim.rig.load import load_rig

REPORT_S = 1.0
"""How often the lab looks whether it has fallen behind."""


@dataclass(frozen=True)
class LabOptions:
    """How a lab is set up.

    Attributes:
        rig: Rig file.
        registers: Register map, a file or a profile.
        sealed: File with hidden effects.
        host: Address to listen on.
        port: Modbus port; 0 takes a free one.
        control_port: Control port, on loopback; 0 takes a free one.
        expose: Whether an address other than loopback is allowed.
        dx_m: Cell length of the plant; None is half of the rig's.
        sample_s: Interval at which voltages are taken, and sensors of a device without a clock.
        period_s: Interval at which a device with a clock samples.
        pace: Seconds of device time per second of a device with a clock whose time waits for the
            machine; None where it is real time.
        standing: Whether time stands still at first, of a device that is paced.
        latency_s: Age of a reading when it becomes visible.
        noise_pa: Noise that replaces the rig's.
        quantum_pa: Quantisation that replaces the rig's.
        watchdog_s: The device's own output watchdog; None is the register map's, or 0.1 s.
        seed: Seed of noise and of malformed answers.
        allow_slow: Start even where real time cannot be kept.
        ready_file: File that is written once the lab can be used.
    """

    rig: Path
    registers: str = "generic_plc"
    sealed: Path | None = None
    host: str = "127.0.0.1"
    port: int = MODBUS_PORT
    control_port: int = CONTROL_PORT
    expose: bool = False
    dx_m: float | None = None
    sample_s: float = 1e-3
    period_s: float = 2e-3
    pace: float | None = None
    standing: bool = False
    latency_s: float = 2e-3
    noise_pa: float | None = None
    quantum_pa: float | None = None
    watchdog_s: float | None = None
    seed: int = 0
    allow_slow: bool = False
    ready_file: Path | None = None


def run_lab(options: LabOptions) -> None:
    """Runs a lab until SIGINT or SIGTERM.

    Args:
        options: How it is set up.

    Raises:
        InputError: It cannot be set up so.
    """
    _check_address(options.host, options.expose)
    if options.ready_file is not None:
        if options.ready_file.is_file() and not _is_ready_file(options.ready_file):
            raise InputError(
                f"{options.ready_file}: exists already and is no ready file of a lab; name another"
            )
        check_output(options.ready_file, force=True)
    rig = load_rig(options.rig)
    if options.sealed is not None:
        rig = rig.model_copy(update={"effects": [*rig.effects, *open_sealed(options.sealed)]})
    registers = load_register_map(options.registers)
    plant = Plant(
        rig,
        {name: output.safe for name, output in registers.outputs.items()},
        dx_m=0.5 * rig.grid.dx_m if options.dx_m is None else options.dx_m,
        sample_s=options.sample_s,
        latency_s=options.latency_s,
        noise_pa=options.noise_pa,
        quantum_pa=options.quantum_pa,
        seed=options.seed,
        pace=_pace(options, registers),
    )
    watchdog_s = options.watchdog_s or registers.device.watchdog_s or 0.1
    # pymodbus logs every fault that is asked for here.
    logging.getLogger("pymodbus.logging").setLevel(logging.CRITICAL)
    device = LabDevice(plant, registers, watchdog_s, options.seed)
    # A device's own clockwork is not held up by other work of the machine that emulates it.
    with precedence():
        asyncio.run(_serve(options, plant, device))


def _pace(options: LabOptions, registers: RegisterMap) -> Pace | None:
    if registers.clock is None:
        if options.pace is not None or options.standing:
            raise InputError(
                f"register map {registers.name!r} has no clock, so the device's time cannot be"
                " paced; logging_plc has one"
            )
        return None
    if options.standing and options.pace is None:
        raise InputError("only the time of a lab with --paced can stand still")
    return Pace(options.period_s, registers.clock.samples.records, options.pace, options.standing)


def _check_address(host: str, expose: bool) -> None:
    try:
        loopback = host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        loopback = False
    if not loopback and not expose:
        raise InputError(
            f"host {host!r} is not this machine's loopback; Modbus has no protection, so only"
            " --expose lets others reach it"
        )


async def _serve(options: LabOptions, plant: Plant, device: LabDevice) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    control = Control(plant, device)
    speed = plant.start(options.allow_slow)
    told = False
    try:
        port = await device.open(options.host, options.port)
        control_port = await control.open(options.control_port)
        ready = {"modbus_port": port, "control_port": control_port, "pid": os.getpid()}
        if options.ready_file is not None:
            write_whole(options.ready_file, json.dumps(ready) + "\n")
            told = True
        print(
            f"lab ready: {plant.rig.name} at {options.host}:{port}, control port {control_port},"
            f" {speed:.1f} times real time",
            flush=True,
        )
        await _watch(stop, plant)
    finally:
        control.close()
        await device.close()
        plant.stop()
        if told and options.ready_file is not None:
            options.ready_file.unlink(missing_ok=True)
    if plant.failure:
        raise InputError(plant.failure)


async def _watch(stop: asyncio.Event, plant: Plant) -> None:
    """Waits for the end, and says so when the plant falls behind real time."""
    skipped_s = 0.0
    while not stop.is_set() and not plant.failure:
        try:
            await asyncio.wait_for(stop.wait(), REPORT_S)
        except TimeoutError:
            status = plant.status()
            if status.skipped_s > skipped_s:
                print(
                    f"lab: behind real time, skipped {status.skipped_s - skipped_s:.2f} s"
                    f" (runs at {status.speed:.2f} times real time)",
                    file=sys.stderr,
                    flush=True,
                )
                skipped_s = status.skipped_s


def _is_ready_file(path: Path) -> bool:
    """Whether a file is what a lab left that was killed, or what another one has written."""
    try:
        return "control_port" in json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError, TypeError):
        return False
