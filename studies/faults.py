# SPDX-License-Identifier: Apache-2.0
"""Every fault that the bridge is to survive, at the device's registers: how soon valves are safe.

A bridge with a controller that holds the valve open, a proxy and the emulated lab; each fault is
tried several times, on an idle machine and beside four busy processes. What is told is from the
fault to the first safe voltage that the device then keeps, how often valves went from safe to open
within a second. Then faults of whole processes (`process_faults`), and of the line, where it counts
whether anything is applied that must not be (`line_faults`). Nothing is subtracted for a machine
that was busy. Likewise a robot (`robot_faults`), both valves of which have to be safe. Writes
``docs/faults.md``.
"""

import argparse
import math
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.progress import track
from tests.bridges import Rig, running_lab, safe_since
from tests.cables import ENDS, pull_and_plug
from tests.proxy import LIES, Proxy

from pneu_hw_bridge.safety.limits import SAFE_WITHIN_S
from studies import line_faults, process_faults, robot_faults
from studies.digest import digest_of

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "faults.md"
TRIES = 6
BUSY = 4
OPEN_V = 5.5
PULLED_S, AFTERWARDS_S = 5.0, 7.0
LOOK_S = 0.8
"""So long after a fault it is looked at what the device has."""


@dataclass
class Bench:
    """What a fault may be done to.

    Attributes:
        lab: The device.
        proxy: What is between.
        rig: The bridge and its controller.
    """

    lab: Any
    proxy: Proxy
    rig: Rig


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    Attributes:
        name: What happens.
        begin: Brings it about.
        before: Done some time before, so that the bridge knows of it.
        bound: Whether valves have to be safe within the bound.
    """

    name: str
    begin: Callable[[Bench], Any]
    before: Callable[[Bench], Any] = lambda bench: None
    bound: bool = True


@dataclass
class Outcome:
    """What became of all tries of one fault.

    Attributes:
        seconds: From the fault to safe valves; infinite where they never were.
        changes: Most changes from safe to open within a second.
        faults: What went wrong besides.
        within_s: The mark; infinite where there is none.
    """

    seconds: list[float] = field(default_factory=list)
    changes: int = 0
    faults: list[str] = field(default_factory=list)
    within_s: float = SAFE_WITHIN_S

    @property
    def late(self) -> bool:
        """Whether a try missed the mark, or there was none."""
        return max(self.seconds, default=math.inf) > self.within_s


@dataclass
class Applied:
    """What must not happen, over all tries of one fault.

    Attributes:
        what: What is counted.
        most: The most that is allowed.
        found: Of each try.
        fault: Why it could not be tried.
    """

    what: str
    most: float
    found: list[float] = field(default_factory=list)
    fault: str = ""

    @property
    def missed(self) -> bool:
        """Whether the mark was missed."""
        return bool(self.fault) or max(self.found, default=math.inf) > self.most


@dataclass
class Results:
    """What was found at one load.

    Attributes:
        at_device: Of each fault at the device.
        of_processes: Of each fault of a process.
        of_line: Of each fault of the line.
        of_robot: Of each fault of a robot.
    """

    at_device: dict[str, Outcome] = field(default_factory=dict)
    of_processes: dict[str, Outcome] = field(default_factory=dict)
    of_line: dict[str, Applied] = field(default_factory=dict)
    of_robot: dict[str, Outcome] = field(default_factory=dict)

    @property
    def missed(self) -> bool:
        """Whether a mark was missed, or a fault could not be tried."""
        timed = (
            *self.at_device.values(),
            *self.of_processes.values(),
            *self.of_robot.values(),
        )
        return any(one.late or one.changes > 1 or one.faults for one in timed) or any(
            one.missed for one in self.of_line.values()
        )


def lab_fault(name: str, **details: Any) -> Callable[[Bench], Any]:
    """A fault of the device.

    Args:
        name: Its name at the lab.
        details: Its channel and value.
    """
    return lambda bench: bench.lab.ask("fault", name=name, **details)


def proxy_is(**values: Any) -> Callable[[Bench], Any]:
    """Has the proxy do something.

    Args:
        values: Its attributes.
    """

    def begin(bench: Bench) -> None:
        for name, value in values.items():
            setattr(bench.proxy, name, value)

    return begin


def says(volts: float) -> Callable[[Bench], Any]:
    """Has the controller command something else.

    Args:
        volts: What.
    """
    return lambda bench: setattr(bench.rig, "volts", volts)


def stop(bench: Bench) -> None:
    """Calls for an emergency stop."""
    bench.rig.link.e_stop("study")
    bench.rig.bus.vent()


def silent(bench: Bench) -> None:
    """Has the controller fall silent."""
    bench.rig.fall_silent()


def cut_then_silent(bench: Bench) -> None:
    """Requests wait on the way; meanwhile the controller falls silent, and then they may go on."""
    bench.proxy.hold = True
    time.sleep(0.4)
    bench.rig.fall_silent()
    time.sleep(0.2)
    bench.proxy.hold = False


FAULTS = [
    Fault("the controller falls silent", silent),
    Fault("commands are no number", says(float("nan"))),
    Fault("commands are infinite", says(float("inf"))),
    Fault("commands are far out of range", says(1e9)),
    Fault("two publishers", lambda bench: bench.rig.link.publishers(2)),
    Fault("a publisher that is no node", lambda bench: bench.rig.link.publishers(1, "no node")),
    Fault("emergency stop", stop),
    Fault("a reading above its limit", lab_fault("out_of_range", channel="end", value=9.5e5)),
    Fault("a sensor at its end", lab_fault("out_of_range", channel="end", value=1.7e6)),
    Fault("a reading that cannot be", lab_fault("out_of_range", channel="end", value=1e7)),
    Fault("a frozen sensor", lab_fault("frozen", channel="end")),
    Fault("swapped registers", lab_fault("word_order")),
    Fault("supply lost", lab_fault("supply"), bound=False),
    Fault("the device hangs up", lab_fault("drop")),
    Fault("the device is silent", lab_fault("silent")),
    Fault("the device refuses", lab_fault("exception")),
    Fault("the device answers nonsense", lab_fault("malformed")),
    Fault("the device takes 0.3 s", lab_fault("slow", value=0.3)),
    *(Fault(name, proxy_is(lie=lie)) for name, lie in LIES.items() if name != "every reply twice"),
    Fault("replies are lost", proxy_is(swallow=True)),
    Fault("connections are cut", lambda bench: bench.proxy.hang_up(), bound=False),
    Fault("requests wait 0.6 s, controller silent meanwhile", cut_then_silent),
    *(
        Fault(f"{what} {ms} ms late, {name}", begin, proxy_is(**{key: 1e-3 * ms}))
        for ms in (20, 50)
        for what, key in (("replies", "reply_s"), ("requests", "request_s"))
        for name, begin in (
            ("controller silent", silent),
            ("emergency stop", stop),
            ("over-pressure", lab_fault("out_of_range", channel="end", value=9.5e5)),
        )
    ),
    Fault("replies 90 ms late: not driven at all", lambda bench: None, proxy_is(reply_s=0.09)),
    Fault("one connection served, controller silent", silent, lambda bench: one_line(bench)),
]


def one_line(bench: Bench) -> None:
    """Has the device serve one connection at a time."""
    bench.proxy.most = 1
    bench.proxy.hang_up()


def attempt(fault: Fault, folder: Path, lab: Any, outcome: Outcome) -> None:
    """Tries a fault once.

    Args:
        fault: It.
        folder: For files.
        lab: The device.
        outcome: Takes what became of it.
    """
    lab.ask("clear")
    proxy = Proxy(lab.port)
    try:
        with Rig(proxy.port) as rig:
            bench = Bench(lab, proxy, rig)
            wait(lambda: lab.volts() == OPEN_V, 10.0)
            fault.before(bench)
            time.sleep(1.5)
            wait(lambda: rig.follows() or "too slow" in rig.link.report().reason, 10.0)
            time.sleep(0.2)
            since = len(lab.ask("history")["history"])
            begun_s = time.monotonic()
            fault.begin(bench)
            time.sleep(LOOK_S)
            if lab.volts() != 0.0:
                outcome.seconds.append(float("inf") if fault.bound else 0.0)
            else:
                outcome.seconds.append(max(safe_since(lab)[0] - begun_s, 0.0))
            time.sleep(1.5)
            changes = lab.ask("history")["history"][since:]
            opened = [
                c["steady_s"]
                for before, c in pairwise(changes)
                if before["volts"]["voltage"] == 0.0 != c["volts"]["voltage"]
            ]
            most = max((sum(t <= s < t + 1.0 for s in opened) for t in opened), default=0)
            outcome.changes = max(outcome.changes, most)
    except TimeoutError:
        outcome.faults.append("valves never followed")
    finally:
        proxy.close()


def wait(condition: Callable[[], bool], seconds: float) -> None:
    """Waits until something is true.

    Args:
        condition: What.
        seconds: How long at most.

    Raises:
        TimeoutError: It did not come true.
    """
    end_s = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end_s:
            raise TimeoutError
        time.sleep(0.005)


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keeps processors busy.

    Args:
        count: With how many processes.
    """
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.send_signal(signal.SIGKILL)
            other.wait()


def processes(folder: Path, tries: int, load: int) -> Iterator[tuple[str, Outcome]]:
    """Tries the faults of processes.

    Args:
        folder: For files.
        tries: How often each.
        load: Busy processes beside; a process that has to begin first has a mark without them only.

    Yields:
        The fault and what became of it.
    """
    folder.mkdir()
    for fault, seconds, wrong in process_faults.tries_of(folder, tries):
        outcome = Outcome(seconds, faults=[wrong] if wrong else [])
        if fault.within_s is not None:
            outcome.within_s = math.inf if load else fault.within_s
        yield fault.name, outcome
    for name, seconds, wrong in process_faults.launches(folder / "launches", tries):
        yield name, Outcome(seconds, faults=[wrong] if wrong else [])


def robots(folder: Path, tries: int) -> Iterator[tuple[str, Outcome]]:
    """Tries the faults of a robot.

    Args:
        folder: For files.
        tries: How often each.

    Yields:
        The fault and what became of it.
    """
    for name, seconds, wrong in robot_faults.tries_of(folder, tries):
        yield name, Outcome(seconds, faults=[wrong] if wrong else [])


def lines_of(folder: Path, tries: int) -> Iterator[tuple[str, Applied]]:
    """Tries the faults of lines.

    Args:
        folder: For files.
        tries: How often each.

    Yields:
        The fault and what became of it.
    """
    for fault in line_faults.FAULTS:
        applied = Applied(fault.counts, fault.most)
        try:
            applied.found += [fault.once() for _ in range(tries)]
        except AssertionError as error:
            applied.fault = str(error)
        yield fault.name, applied
    of_cables = {
        f"a cable is out for {PULLED_S:g} s, its bridge {how}": Applied("old commands applied", 0.0)
        for how in ENDS
    }
    for k in range(tries):
        part = folder / f"cables{k}"
        part.mkdir(parents=True)
        try:
            found = pull_and_plug(part, ENDS, PULLED_S, AFTERWARDS_S)
        except (pytest.skip.Exception, TimeoutError) as error:
            for applied in of_cables.values():
                applied.fault = str(error)
            break
        for applied, opened in zip(of_cables.values(), found.values(), strict=True):
            applied.found.append(float(len(opened)))
    yield from of_cables.items()


def page(found: dict[int, Results], tries: int) -> str:
    """The results as a page.

    Args:
        found: By load what became of each fault.
        tries: How often each was tried.
    """
    source = digest_of([ROOT / "src" / "pneu_hw_bridge" / "pneu_hw_bridge"])
    lines = [
        "# Faults, at the device",
        "",
        f"Made by `make faults`: each fault {tries} times, on an idle machine of {os.cpu_count()}"
        f" processors and beside {BUSY} busy processes. Milliseconds from the fault to the safe"
        f" voltage that the device then keeps; the mark is {1e3 * SAFE_WITHIN_S:.0f} ms, nothing is"
        " subtracted. A device whose line or bridge is dead has its own watchdog of 100 ms."
        " Openings: the most within a second afterwards; one is allowed.",
        f"Made from the bridge's sources {source}.",
        "",
    ]
    for load, results in found.items():
        lines += [f"## {'Idle' if not load else f'{load} busy processes'}", ""]
        lines += _timed("faults at the device", results.at_device)
        lines += _timed("faults of processes", results.of_processes)
        lines += _timed("faults of a robot with two valves and an encoder", results.of_robot)
        failed = [f"{name}: {one.fault}" for name, one in results.of_line.items() if one.fault]
        missed = [name for name, one in results.of_line.items() if one.missed]
        lines += [
            f"* {len(results.of_line)} faults of the line; beyond the mark or not tried:"
            f" {len(missed)}{_named(failed or missed)}",
            "",
            "| fault | tries | most | of | allowed |",
            "|---|---|---|---|---|",
        ]
        for name, applied in results.of_line.items():
            most = f"{max(applied.found):.3g}" if applied.found else "-"
            row = (name, len(applied.found), most, applied.what, f"{applied.most:g}")
            lines.append(f"| {' | '.join(map(str, row))} |")
        lines.append("")
    return "\n".join(lines)


def _named(names: list[str]) -> str:
    return f" ({'; '.join(names)})" if names else ""


def _timed(what: str, outcomes: dict[str, Outcome]) -> list[str]:
    """What is told of faults after which valves have to be safe."""
    late = [name for name, one in outcomes.items() if one.late]
    flutter = [name for name, one in outcomes.items() if one.changes > 1]
    failed = [f"{name}: {one.faults[0]}" for name, one in outcomes.items() if one.faults]
    lines = [
        f"* {len(outcomes)} {what}; beyond the mark: {len(late)}{_named(late)}",
        f"* more than one opening a second: {len(flutter)}{_named(flutter)}",
        f"* could not be tried, or went wrong besides: {len(failed)}{_named(failed)}",
        "",
        "| fault | tries | min | median | max | openings a second |",
        "|---|---|---|---|---|---|",
    ]
    for name, one in outcomes.items():
        shown = "| - | - | - "
        if one.seconds:
            of = (min(one.seconds), statistics.median(one.seconds), max(one.seconds))
            shown = "".join(f"| {1e3 * s:.0f} " for s in of)
        remark = "" if one.within_s == SAFE_WITHIN_S else f" (mark {1e3 * one.within_s:.0f} ms)"
        remark = " (no bound)" if math.isinf(one.within_s) else remark
        lines.append(f"| {name}{remark} | {len(one.seconds)} {shown}| {one.changes} |")
    return [*lines, ""]


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns 1 where a mark was missed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tries", type=int, default=TRIES)
    parser.add_argument("--loads", type=int, nargs="*", default=[0, BUSY])
    parser.add_argument(
        "--only", default="", help="a part of the names of faults at the device, or robot"
    )
    options = parser.parse_args(arguments)
    console = Console()
    found: dict[int, Results] = {}
    with tempfile.TemporaryDirectory() as name, running_lab(Path(name)) as lab:
        for load in options.loads:
            results = found[load] = Results()
            chosen = [fault for fault in FAULTS if options.only in fault.name]
            with busy(load):
                for fault in track(chosen, f"{load} busy processes", console=console):
                    outcome = results.at_device[fault.name] = Outcome()
                    outcome.within_s = SAFE_WITHIN_S if fault.bound else math.inf
                    for _ in range(options.tries):
                        attempt(fault, Path(name), lab, outcome)
                if not options.only or options.only == "robot":
                    some_robots = robots(Path(name) / f"robots{load}", options.tries)
                    count = len(robot_faults.FAULTS)
                    results.of_robot.update(track(some_robots, "robot", count, console=console))
                if options.only:
                    continue
                count = len(process_faults.FAULTS) + len(process_faults.LAUNCHES)
                some = processes(Path(name) / f"processes{load}", options.tries, load)
                results.of_processes.update(track(some, "processes", count, console=console))
                some_lines = lines_of(Path(name) / f"lines{load}", options.tries)
                count = len(line_faults.FAULTS) + len(ENDS)
                results.of_line.update(track(some_lines, "lines", count, console=console))
    text = page(found, options.tries)
    console.print(text, soft_wrap=True)
    if not options.only:
        PAGE.write_text(text, encoding="utf-8")
    return int(any(results.missed for results in found.values()))


if __name__ == "__main__":
    sys.exit(main())
