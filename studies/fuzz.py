# SPDX-License-Identifier: Apache-2.0
"""Thousands of spoilt inputs: does every command end in a result, or in one sentence?

Rig files, bags, tables and command lines are spoilt at random, and the commands of `pneu` are run
on them in a worker process. A command has to end in time with status 0, or with status 2 and one
line on stderr that begins with ``pneu: ``; a refused command leaves no file, and no command leaves
one half-written. A case is the same for the same seed and number; ``--only KIND:NUMBER`` repeats
it. The inputs of failures are kept in ``out/fuzz``.
"""

import argparse
import multiprocessing
import os
import re
import resource
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from pneu_common.progress import progress

ROOT = Path(__file__).resolve().parent.parent
KEPT = ROOT / "out" / "fuzz"
KIND_NAMES = ("rig", "bag", "csv", "command")

LIMIT_S = 10.0
"""Processor time that a command may take, so that a busy machine does not count as a hang."""
ASLEEP = 12.0
"""Multiple of it that a command may take by the clock, however little it computes."""
LOOK_S = 0.5
STARTUP_S = 180.0
"""Time that a worker may take to load and compile."""
MEMORY_BYTES = 4 << 30
"""Memory that a worker may map."""
PROGRESS = re.compile(r"^(?:.*: [\d:]+ so far.*|done after [\d:]+)\n", re.MULTILINE)
"""What commands say about themselves where the machine is slow; `pneu_common.progress`."""
LONGEST_LINE = 1000
"""Characters of a sentence that can be read, the names of files among them."""


@dataclass
class Ended:
    """How a command of a case ended.

    Attributes:
        words: The command.
        status: Exit status; None where it did not end by itself.
        fault: What is wrong with that; empty where nothing is.
        stderr: What it said.
        seconds: How long it took.
    """

    words: list[str]
    status: int | None
    fault: str
    stderr: str
    seconds: float


@dataclass
class Tally:
    """What became of the cases of one kind.

    Attributes:
        cases: Number of them.
        accepted: Commands with status 0.
        refused: Commands with status 2.
        failed: Failures.
    """

    cases: int = 0
    accepted: int = 0
    refused: int = 0
    failed: list[tuple[str, Ended]] = field(default_factory=list)


# ---- in the worker ------------------------------------------------------------------------------


def _work(pipe: Connection, memory_bytes: int) -> None:
    """Runs cases as they are asked for, until the pipe ends."""
    from pneu_common.cli import build_app
    from pneu_sim.effects.registry import _loaded as loaded_effects
    from studies.fuzz_cases import make_case

    os.environ.pop("PNEU_TRACEBACK", None)
    os.environ["ROS_LOG_DIR"] = tempfile.gettempdir()
    app = build_app()
    resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    pipe.send("ready")
    while True:
        try:
            kind, seed, number, folder = pipe.recv()
        except EOFError:
            return
        os.chdir(folder)
        loaded_effects.clear()  # a process of its own would know those of no other case
        case = make_case(kind, seed, number, Path(folder))
        try:
            words = next(case)
            while True:
                pipe.send(words)
                ended = run_one(app, words, Path(folder))
                pipe.send(ended)
                words = case.send(-1 if ended.status is None else ended.status)
        except StopIteration:
            pass
        os.chdir("/")
        pipe.send("done")


def run_one(app: Any, words: list[str], folder: Path) -> Ended:
    """Runs one command in this process and judges how it ended.

    Args:
        app: The `pneu` application.
        words: The command without ``pneu``.
        folder: Its working folder, whose files are compared before and after.
    """
    before = _files(folder)
    begun = time.monotonic()
    status: int | None = None
    with _caught() as said:
        try:
            app(words, prog_name="pneu")
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        except BaseException as error:
            said.append(f"{type(error).__name__} came out of the command: {error}\n")
    seconds = time.monotonic() - begun
    stderr = "".join(said)
    fault = _fault(status, stderr, before, _files(folder))
    return Ended(words, status, fault, stderr, seconds)


def _fault(status: int | None, stderr: str, before: dict[str, Any], after: dict[str, Any]) -> str:
    """What is wrong with how a command ended; empty where nothing is."""
    stderr = PROGRESS.sub("", stderr)
    new = sorted(name for name, what in after.items() if before.get(name) != what)
    lost = sorted(set(before) - set(after))
    aside = [name for name in new if ".part" in name or Path(name).name.startswith(".")]
    if "Traceback (most recent" in stderr:
        return "a traceback"
    if "error inside the program" in stderr or status not in (0, 2):
        return f"status {status}"
    if "Warning: " in stderr:
        return "a warning of Python's"
    if aside:
        return f"left half-written: {', '.join(aside)}"
    if lost and status:
        return f"lost: {', '.join(lost)}"
    if status == 0:
        return ""
    if new:
        return f"refused, and yet written: {', '.join(new)}"
    if not stderr.startswith("pneu: ") or stderr.count("\n") != 1:
        return "not one line that begins with 'pneu: '"
    if len(stderr) > LONGEST_LINE:
        return f"a sentence of {len(stderr)} characters"
    if not stderr.strip().isprintable():
        return "characters that cannot be printed"
    return ""


def _files(folder: Path) -> dict[str, tuple[int, int, int]]:
    """Size, time and identity of every file below a folder."""
    out = {}
    for base, _, names in os.walk(folder):
        for name in names:
            stat = os.stat(os.path.join(base, name), follow_symlinks=False)
            path = os.path.relpath(os.path.join(base, name), folder)
            out[path] = (stat.st_size, stat.st_mtime_ns, stat.st_ino)
    return out


@contextmanager
def _caught() -> Iterator[list[str]]:
    """Takes what this process writes to its standard streams, whoever writes it."""
    said: list[str] = []
    with tempfile.TemporaryFile() as errors, open(os.devnull, "wb") as nowhere:
        kept = os.dup(1), os.dup(2)
        sys.stdout.flush()
        sys.stderr.flush()
        os.dup2(nowhere.fileno(), 1)
        os.dup2(errors.fileno(), 2)
        try:
            yield said
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            for number, old in zip((1, 2), kept, strict=True):
                os.dup2(old, number)
                os.close(old)
            errors.seek(0)
            said.insert(0, errors.read().decode(errors="replace"))


# ---- beside it ----------------------------------------------------------------------------------


class Worker:
    """A process that runs cases, and is replaced where one hangs or kills it."""

    def __init__(self, limit_s: float = LIMIT_S, memory_bytes: int = MEMORY_BYTES) -> None:
        self._limit_s = limit_s
        self._memory_bytes = memory_bytes
        self._context = multiprocessing.get_context("spawn")
        self._process: Any = None
        self._pipe: Any = None

    def run(self, kind: str, seed: int, number: int, folder: Path) -> list[Ended]:
        """Runs a case in a folder and tells how its commands ended.

        Args:
            kind: Its kind.
            seed: Seed of the run.
            number: Its number.
            folder: An empty folder.
        """
        if self._process is None or not self._process.is_alive():
            self._start()
        self._pipe.send((kind, seed, number, str(folder)))
        out: list[Ended] = []
        words: list[str] = ["(making the case)"]
        begun, computed_s = time.monotonic(), self._computed_s()
        while True:
            fault = ""
            try:
                # What it draws and writes beforehand is not what is timed.
                if self._pipe.poll(min(LOOK_S, self._limit_s)):
                    answer = self._pipe.recv()
                    if answer == "done":
                        return out
                    if isinstance(answer, Ended):
                        out.append(answer)
                    else:
                        words = answer
                    begun, computed_s = time.monotonic(), self._computed_s()
                    continue
                computed = self._computed_s() - computed_s > self._limit_s
                asleep = time.monotonic() - begun > ASLEEP * self._limit_s
                if not (computed or asleep):
                    continue
                fault = f"not at an end after {self._limit_s:g} s"
            except EOFError:
                self._process.join(5.0)
                fault = f"the process died (status {self._process.exitcode})"
            self.stop()
            out.append(Ended(words, None, fault, "", time.monotonic() - begun))
            return out

    def _computed_s(self) -> float:
        """Processor time of the process so far, s."""
        text = Path(f"/proc/{self._process.pid}/stat").read_text()
        user, system = text.rpartition(")")[2].split()[11:13]
        return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        """Ends the process, whatever it is doing."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._pipe.close()
            self._process = None

    def _start(self) -> None:
        self.stop()
        self._pipe, other = self._context.Pipe()
        self._process = self._context.Process(
            target=_work, args=(other, self._memory_bytes), daemon=True
        )
        self._process.start()
        other.close()
        if not self._pipe.poll(STARTUP_S) or self._pipe.recv() != "ready":
            raise RuntimeError("the worker does not start")
        # The first commands load and compile, which is not what is timed.
        limit_s, self._limit_s = self._limit_s, STARTUP_S
        try:
            with tempfile.TemporaryDirectory() as name:
                self.run("warm", 0, 0, Path(name))
        finally:
            self._limit_s = limit_s


def run_cases(
    worker: Worker, cases: list[tuple[str, int]], seed: int, keep: Path | None, told: Any = None
) -> dict[str, Tally]:
    """Runs cases and tells what became of them, by kind.

    Args:
        worker: Where they run.
        cases: Kind and number of each.
        seed: Seed of the run.
        keep: Folder that gets the inputs of failures; None keeps none.
        told: Called after each case with its kind and the tallies so far.
    """
    tallies = {kind: Tally() for kind in KIND_NAMES}
    for kind, number in cases:
        with tempfile.TemporaryDirectory(prefix="fuzz_", ignore_cleanup_errors=True) as name:
            ends = worker.run(kind, seed, number, Path(name))
            tally = tallies[kind]
            tally.cases += 1
            for end in ends:
                tally.accepted += end.status == 0
                tally.refused += end.status == 2
                if end.fault:
                    tally.failed.append((f"{kind}:{number}", end))
            if keep is not None and any(end.fault for end in ends):
                kept = keep / f"{seed}_{kind}_{number}"
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(name, kept)
        if told is not None:
            told(kind, tallies)
    return tallies


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="cases of all kinds together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KIND_NAMES, action="append", help="only this kind")
    parser.add_argument("--only", metavar="KIND:NUMBER", action="append", help="only this case")
    options = parser.parse_args(arguments)
    kinds = options.kind or list(KIND_NAMES)
    if options.only:
        parted = [text.partition(":") for text in options.only]
        cases = [(kind, int(number)) for kind, _, number in parted]
    else:
        cases = [(kinds[n % len(kinds)], n // len(kinds)) for n in range(options.count)]
    begun = time.monotonic()
    worker = Worker()
    with progress("fuzzing") as tell:

        def told(kind: str, tallies: dict[str, Tally]) -> None:
            done = sum(tally.cases for tally in tallies.values())
            failed = sum(len(tally.failed) for tally in tallies.values())
            tell("fuzzing", done / len(cases), f"{kind}, {failed} failures")

        try:
            tallies = run_cases(worker, cases, options.seed, KEPT, told)
        finally:
            worker.stop()
    seconds = time.monotonic() - begun
    for kind, tally in tallies.items():
        print(
            f"{kind}: {tally.cases} cases, {tally.accepted} commands accepted, {tally.refused}"
            f" refused, {len(tally.failed)} failures"
        )
        alike: dict[str, list[tuple[str, Ended]]] = {}
        for label, end in tally.failed:
            said = re.sub(r"[0-9]+|'.*?'", "_", end.stderr[:300])
            alike.setdefault(f"{end.words[0]} {end.fault[:20]} {said}", []).append((label, end))
        for group in alike.values():
            label, end = group[0]
            print(f"\n  {label}: {end.fault} ({end.seconds:.1f} s)")
            print(f"    pneu {shlex.join(end.words)[:1500]}")
            for line in end.stderr.splitlines()[-4:]:
                print(f"    | {line[:400]}")
            if len(group) > 1:
                print(f"    and alike: {', '.join(one for one, _ in group[1:])}"[:400])
    print(f"{len(cases)} cases in {seconds:.0f} s; inputs of failures are in {KEPT}")
    return 1 if any(tally.failed for tally in tallies.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
