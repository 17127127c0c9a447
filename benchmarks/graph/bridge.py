# SPDX-License-Identifier: Apache-2.0
"""The valve bridge in front of the emulated lab: latencies through it, and who uses what CPU."""

from __future__ import annotations

import contextlib
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.graph.processes import Program, environment, quantiles, running
from benchmarks.report import ROOT, Table
from pneu_hw_bridge.lab.asking import ask

RATE_HZ = 500.0
RIG = ROOT / "rigs" / "lab.yaml"


def node(module: str, **parameters: object) -> list[str]:
    """Command line of a node."""
    words = ["-m", "pneu_runtime", "-m", module, "--ros-args"]
    for name, value in parameters.items():
        words += ["-p", f"{name}:={str(value).lower() if isinstance(value, bool) else value}"]
    return words


@contextlib.contextmanager
def lab_and_bridge() -> Iterator[tuple[Program, Program, int, dict[str, str]]]:
    """Both as processes, ready; with the lab's control port and the domain's variables."""
    variables = environment()
    with tempfile.TemporaryDirectory() as folder:
        ready = Path(folder) / "ready.json"
        lab_words = ["-m", "pneu_common.cli", "lab", "--rig", str(RIG), "--port", "0"]
        lab_words += ["--control-port", "0", "--allow-slow", "--ready-file", str(ready)]
        with running(*lab_words, variables=variables, asked=False) as lab:
            lab.wait(ready.exists, 180.0)  # it compiles its kernels where they are not
            ports = json.loads(ready.read_text(encoding="utf-8"))
            words = node(
                "pneu_hw_bridge.nodes.valve_bridge",
                port=ports["modbus_port"],
                rate_hz=RATE_HZ,
                publish_rate_hz=RATE_HZ,
                autostart=True,
            )
            with running(*words, variables=variables, asked=False) as bridge:
                yield lab, bridge, ports["control_port"], variables


def latencies(quick: bool) -> Table:
    """Command to register, register to topic."""
    commands, readings = (800, 60) if quick else (6000, 500)
    table = Table(
        "Graph: latency through the valve bridge",
        f"Bridge and controller at {RATE_HZ:g} Hz against `pneu lab` over Modbus TCP on loopback,"
        " each a process. Command: from publishing a ValveCommand to the device's register."
        " Reading: from when the register holds it to the callback, the wait for the next poll of"
        " the device included; the sensor's own delay is not.",
        {
            "way": "way",
            "count": "samples",
            "p50_ms": "p50, ms",
            "p99_ms": "p99, ms",
            "rate_hz": "messages / s",
            "arrived": "arrived, %",
        },
    )
    with (
        lab_and_bridge() as (_, _, control_port, variables),
        running(
            "-m", "benchmarks.graph.bridge_probe", str(control_port), variables=variables
        ) as probe,
    ):
        probe.order(measure="commands", count=commands)
        there = probe.answer(90.0)
        probe.order(measure="readings", count=readings)
        back = probe.answer(90.0)
    for way, found, more in (
        (
            "command to register",
            there,
            {"rate_hz": there["rate_hz"], "arrived": 100.0 * there["arrived"]},
        ),
        ("register to topic", back, {"rate_hz": there["readings_hz"]}),
    ):
        p50, p99 = quantiles(found["latency_s"])
        row = {"way": way, "count": len(found["latency_s"])}
        table.rows.append({**row, "p50_ms": 1e3 * p50, "p99_ms": 1e3 * p99, **more})
    table.notes.append(
        "A command does not arrive where the next one overtakes it before the bus is free."
    )
    return table


def shares(quick: bool) -> Table:
    """CPU of every process of a running rig."""
    duration_s = 3.0 if quick else 15.0
    table = Table(
        "Graph: CPU of a running rig",
        f"PID tracker and bridge at {RATE_HZ:g} Hz on `pneu lab` with `rigs/lab.yaml`, whose gas is"
        f" computed in real time. Share of one core over {duration_s:g} s.",
        {"process": "process", "cpu": "CPU of a core, %"},
    )
    if not sys.platform.startswith("linux"):
        table.notes.append("Measured on Linux only.")
        return table
    pid_words = node("pneu_policy.nodes.pid", rate_hz=RATE_HZ, autostart=True)
    with (
        lab_and_bridge() as (lab, bridge, control_port, variables),
        running(*pid_words, variables=variables, asked=False) as pid,
        running(*node("pneu_policy.nodes.target"), variables=variables, asked=False) as target,
    ):

        def commanded() -> bool:
            """Whether the controller has moved the valve: 0 V is safe, 5 V is its null."""
            return ask(control_port, {"do": "status"})["volts"]["voltage"] not in (0.0, 5.0)

        pid.wait(commanded)
        time.sleep(1.0)
        names = {"lab": lab, "bridge": bridge, "controller": pid, "target generator": target}
        before = {name: program.cpu_s() for name, program in names.items()}
        begin_s = time.monotonic()
        time.sleep(duration_s)
        spent_s = time.monotonic() - begin_s
        for name, program in names.items():
            share = 100.0 * (program.cpu_s() - before[name]) / spent_s
            table.rows.append({"process": name, "cpu": share})
        pid.wait(commanded, 10.0)
    return table
