# SPDX-License-Identifier: Apache-2.0
"""The nodes on the genuine rclpy of ROS 2 Jazzy: tests, and times beside the embedded runtime.

Each stage keeps its result in ``out/ros``; once all have one, ``docs/results/ros.md`` is written. A
stage is a group of tests, or ``times``, which measures both runtimes in turn. The exit status is 1
where a test fails or a valve was safe too late. Run by ``make test-ros``, which sets PNEU_RCLPY.
"""

import argparse
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from benchmarks.graph.exchange import pairs
from benchmarks.graph.processes import OURS, REAL, environment, quantiles, running
from tests.measured import NOT_PROVEN, SAFE_WITHIN_S

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_graph.bag.reader import BagReader
from pneu_hw_bridge.lab.asking import ask
from pneu_runtime import hook
from studies.digest import digest_of

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "results" / "ros.md"
OUT = ROOT / "out" / "ros"
PACKAGES = ("pneu_runtime", "pneu_graph", "pneu_sim", "pneu_hw_bridge", "pneu_sysid", "pneu_policy")
SOURCES = [ROOT / "msgs", ROOT / "tests"]
SOURCES += [ROOT / "src" / package / part for package in PACKAGES for part in (package, "test")]
GROUPS = {
    "conformance": ["tests/conformance"],
    "faults": ["tests/test_faults.py"],
    "simulated": ["tests/test_faults_simulated.py"],
    "graph": ["tests/test_graph.py"],
    "robot": ["tests/test_robot_graph.py", "tests/test_robot_replay.py"],
    "bridge": [
        "src/pneu_hw_bridge/test/test_valve_bridge.py",
        "src/pneu_hw_bridge/test/test_writers.py",
        "src/pneu_hw_bridge/test/test_stop_graph.py",
    ],
    "recorder": ["src/pneu_graph/test"],
    "policy": [
        "src/pneu_policy/test/test_policy_nodes.py",
        "src/pneu_policy/test/test_play_node.py",
        "src/pneu_policy/test/test_robot_node.py",
        "src/pneu_policy/test/test_live_bag.py",
    ],
    "other": [
        "src/pneu_sim/test/test_simulator_node.py",
        "src/pneu_sim/test/test_observer_node.py",
        "src/pneu_sysid/test/test_identify_node.py",
        "src/pneu_sysid/test/test_replay_node.py",
    ],
}
"""Files and folders of the tests by stage."""
TIMES = "times"
ROUNDS, TRIPS = 6, 2000
RATE_HZ = 500.0
SETTLE_S, MEASURE_S = 3.0, 20.0
TOPICS = {
    "/lab/taps/end/pressure": "cycles of the bridge a second",
    "/lab/valve/command": "cycles of the controller a second",
}


def tested(paths: list[str]) -> dict[str, Any]:
    """Run a group of tests.

    Args:
        paths: Files and folders of the tests.

    Returns:
        The outcome that ``conftest.py`` writes.

    Raises:
        RuntimeError: pytest ended without an outcome.
    """
    with tempfile.TemporaryDirectory(prefix="pneu-ros-") as folder:
        outcome = Path(folder) / "outcome.json"
        # One worker: a test that makes it crash fails, and the next one has another.
        words = ["-m", "pytest", "-p", "xdist.plugin", "--numprocesses=1"]
        words += ["-p", "pytest_rerunfailures", "--reruns=2", "-q"]
        # The pytest plugins of a ROS installation are made for an older pytest.
        variables = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
        command = [sys.executable, *words, f"--outcome={outcome}", *paths]
        status = subprocess.run(command, cwd=ROOT, env=variables, check=False).returncode
        if not outcome.is_file():
            raise RuntimeError(f"pytest ended with status {status} and without an outcome")
        return dict(json.loads(outcome.read_text(encoding="utf-8")))


def times() -> dict[str, dict[str, float]]:
    """Measure both runtimes in turn.

    Returns:
        By runtime the figures by their names.
    """
    found = trips()
    for stack, figures in found.items():
        figures.update(cycles(stack))
    return found


def trips() -> dict[str, dict[str, float]]:
    """Measure round trips of a FluidPressure between two processes, in rounds by turns.

    Returns:
        By runtime the figures by their names.
    """
    round_ns: dict[str, list[float]] = {OURS: [], REAL: []}
    cpu_s = dict.fromkeys(round_ns, 0.0)
    with pairs("FluidPressure", "echo", "ping") as ends:
        for number in range(ROUNDS + 1):
            for stack in round_ns:
                before_s = sum(end.cpu_s() for end in ends[stack])
                ping = ends[stack][1]
                ping.order(count=TRIPS)
                answer = ping.answer()
                if number:  # the first round warms up
                    round_ns[stack] += answer["round_ns"]
                    cpu_s[stack] += sum(end.cpu_s() for end in ends[stack]) - before_s
    found = {}
    for stack, values in round_ns.items():
        p50, p99 = quantiles(values)
        found[stack] = {
            "round trip p50, us": 1e-3 * p50,
            "round trip p99, us": 1e-3 * p99,
            "processor time per message, us": 1e6 * cpu_s[stack] / (2 * len(values)),
        }
    return found


def cycles(stack: str) -> dict[str, float]:
    """Run the launch file on the emulated lab at 500 Hz with a recorder.

    Args:
        stack: The runtime.

    Returns:
        Cycles reached per second, by the recording, and the processor cores in use.
    """
    variables = environment(stack)
    lab = ["-m", "pneu_common.cli", "lab", "--rig", "rigs/lab.yaml", "--port", "0"]
    lab += ["--control-port", "0", "--dx", "0.1", "--allow-slow", "--ready-file"]
    launch = ["-m", "pneu_common.cli", "launch", "pneu_bringup", "rig.launch.yaml"]
    with tempfile.TemporaryDirectory(prefix="pneu-ros-") as name:
        folder = Path(name)
        ready, parameters, bag = folder / "ready.json", folder / "parameters.yaml", folder / "bag"
        usual = (ROOT / "ros_ws/src/pneu_bringup/config/lab.yaml").read_text(encoding="utf-8")
        faster = f"/lab/pid:\n  ros__parameters:\n    rate_hz: {RATE_HZ}\n"
        parameters.write_text(f"{usual}\n{faster}", encoding="utf-8")
        with running(*lab, str(ready), variables=variables, asked=False) as device:
            device.wait(ready.is_file, 180.0)  # it compiles its kernels where they are not kept
            ports = json.loads(ready.read_text(encoding="utf-8"))
            launch += ["backend:=modbus", f"port:={ports['modbus_port']}", f"record:={bag}"]
            launch.append(f"params:={parameters}")
            with running(*launch, variables=variables, asked=False) as nodes:

                def driven() -> bool:
                    """Whether the controller moves the valve: 0 V is safe, 5 V is its null."""
                    volts = ask(ports["control_port"], {"do": "status"})["volts"]["voltage"]
                    return volts not in (0.0, 5.0)

                nodes.wait(driven)
                time.sleep(SETTLE_S)
                begin_ns, before_s = time.time_ns(), nodes.cpu_s(with_children=True)
                time.sleep(MEASURE_S)
                end_ns, after_s = time.time_ns(), nodes.cpu_s(with_children=True)
        spent_s = 1e-9 * (end_ns - begin_ns)
        counts = Counter(
            message.topic
            for message in BagReader(bag).messages(set(TOPICS), begin_ns)
            if message.log_time_ns < end_ns
        )
    found = {what: counts[topic] / spent_s for topic, what in TOPICS.items()}
    return found | {"processor cores of all nodes": (after_s - before_s) / spent_s}


def genuine() -> str:
    """Return the versions of the genuine rclpy and its middleware.

    Raises:
        InputError: PNEU_RCLPY does not ask for the genuine rclpy, or it cannot be used.
    """
    if os.environ.get(hook.CHOICE) != "ros" or hook.install():
        raise InputError(f"set {hook.CHOICE}=ros, as `make test-ros` does")
    from rclpy.utilities import get_rmw_implementation_identifier

    name = max(importlib.metadata.packages_distributions()["rclpy"])  # `ros-rclpy` of the wheels
    return f"{name} {importlib.metadata.version(name)}, {get_rmw_implementation_identifier()}"


def page(kept: dict[str, Any], runtime: str) -> str:
    """Return the results as a page.

    Args:
        kept: By stage its result, with the digest of its sources.
        runtime: Versions of the genuine rclpy and its middleware.
    """
    lines = [
        "# The nodes on the genuine rclpy",
        "",
        f"Made by `make test-ros` on {runtime}, Python {platform.python_version()} and"
        f" {os.cpu_count()} processors. Each row names the sources that it is of. A test has three"
        " tries. *Not proven* is a time that the machine was too busy to measure. *Safe after* is"
        " the longest time after a fault until the valves were safe, with nothing subtracted;"
        f" {1e3 * SAFE_WITHIN_S:.0f} ms are allowed.",
        "",
        "| tests | passed | failed | not proven | skipped | safe after, ms | sources |",
        "|---|---|---|---|---|---|---|",
    ]
    named = []
    for group in GROUPS:
        one = kept[group]
        unproven = [skip for skip in one["skipped"] if skip["reason"].startswith(NOT_PROVEN)]
        skipped = [skip for skip in one["skipped"] if skip not in unproven]
        longest_s = max(one["safe_after_s"].values(), default=None)
        row = (
            group,
            one["counts"]["passed"],
            len(one["failed"]),
            len(unproven),
            len(skipped),
            "-" if longest_s is None else f"{1e3 * longest_s:.0f}",
            one["sources"],
        )
        lines.append(f"| {' | '.join(map(str, row))} |")
        named += [f"- failed: `{test}`" for test in one["failed"]]
        named += [f"- {skip['reason']}: `{skip['test']}`" for skip in (*unproven, *skipped)]
    lines += ["", *named] if named else []
    of = kept[TIMES]
    lines += [
        "",
        "## Beside the embedded runtime",
        "",
        f"Both in the same run, from the sources {of['sources']}. A round trip is a FluidPressure"
        f" to another process and back, {ROUNDS} rounds of {TRIPS} by turns; each of the two"
        " processes receives one message and sends one. Cycles are those of `rig.launch.yaml` with"
        f" bridge, controller, target and recorder on the emulated lab, with {RATE_HZ:g} a second"
        f" asked for, counted in the recording over {MEASURE_S:g} s; processor cores are those of"
        " all nodes, without the lab. Compare columns, not absolutes.",
        "",
        f"| | {' | '.join('embedded' if s == OURS else 'genuine' for s in of['times'])} |",
        f"|---|{'---|' * len(of['times'])}",
    ]
    for what in of["times"][OURS]:
        values = (figures[what] for figures in of["times"].values())
        lines.append(f"| {what} | {' | '.join(f'{value:.3g}' for value in values)} |")
    return "\n".join([*lines, ""])


def main(arguments: list[str] | None = None) -> int:
    """Run the stages and return the exit status.

    Args:
        arguments: The command line; that of the process where None.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    every = [*GROUPS, TIMES]
    parser.add_argument("stages", nargs="*", help=f"some of {', '.join(every)}; all if none")
    chosen = parser.parse_args(arguments).stages or every
    if unknown := set(chosen) - set(every):
        parser.error(f"no stage {', '.join(sorted(unknown))}; there are {', '.join(every)}")
    runtime = genuine()
    OUT.mkdir(parents=True, exist_ok=True)
    failed = 0
    for stage in chosen:
        print(f"\n{stage}", flush=True)
        sources = digest_of(SOURCES)
        result = {"times": times()} if stage == TIMES else tested(GROUPS[stage])
        late = max(result.get("safe_after_s", {}).values(), default=0.0) > SAFE_WITHIN_S
        failed += bool(result.get("failed")) or late
        text = json.dumps({**result, "sources": sources}, indent=2)
        write_whole(OUT / f"{stage}.json", text)
    files = {stage: OUT / f"{stage}.json" for stage in every}
    missing = [stage for stage, file in files.items() if not file.is_file()]
    if missing:
        print(f"{PAGE.name} is written once these have run: {', '.join(missing)}")
    else:
        kept = {stage: json.loads(f.read_text(encoding="utf-8")) for stage, f in files.items()}
        PAGE.parent.mkdir(parents=True, exist_ok=True)
        text = page(kept, runtime)
        print(text)
        write_whole(PAGE, text)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
