# SPDX-License-Identifier: Apache-2.0
"""Run the tests in parts, some of them side by side, and report what was left out.

1. The kernels are compiled, by tests that need most of them.
2. Then follows what runs against the clock.
3. What computes, and with `--lint` ruff and mypy, fill from the beginning and at idle priority the
   time that the others wait: the scheduler hands a processor over at once where a task of ordinary
   priority wants it.

The marks in the files say which part a test belongs to (`pyproject.toml`); `--long` runs those that
are marked long instead. Another user may stall a machine, so what runs against the clock has three
tries. The last lines say how many tests passed, which were skipped and why, which needed another
try, and whether the times in which valves have to be safe were proven: nothing is subtracted from
them, so on a machine too busy to keep them they are not, and this is said. Exit status 1 where
a test or a check fails.
"""

import argparse
import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CHECKS = {
    "ruff": ["ruff", "check", "--quiet", "."],
    "ruff format": ["ruff", "format", "--check", "--quiet", "."],
    "mypy": ["mypy", "--no-error-summary"],
}
CLOCK = "what runs against the clock"
NONE_COLLECTED = 5

sys.path.insert(0, str(ROOT))
from tests.domains import SHARE  # noqa: E402
from tests.measured import NOT_PROVEN, SAFE_WITHIN_S  # noqa: E402


@dataclasses.dataclass
class Part:
    """Tests that run as one.

    Attributes:
        name: What the lines of its output begin with.
        mark: Of its tests, named in each file that has any; None for those that have no such mark.
        workers: Processes side by side.
        words: Further words for pytest.
        idle: Whether they run at idle priority.
    """

    name: str
    mark: str | None
    workers: int = 2
    words: tuple[str, ...] = ()
    idle: bool = False


FILLING = Part("what computes", None, idle=True)
FOLLOWING = (
    Part("kernels", "compiles", workers=1),
    Part(CLOCK, "realtime", words=("--reruns", "2")),
)
"""Parts one after the other, beside the part that fills the time that they wait."""
PARTS = (FILLING, *FOLLOWING)


def main():
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("paths", nargs="*", help="tests to run instead of all of them")
    parser.add_argument("--long", action="store_true", help="those that are marked long")
    parser.add_argument("--lint", action="store_true", help="ruff and mypy as well")
    options = parser.parse_args()
    checks = []
    if options.lint:
        for name, words in CHECKS.items():
            command = [sys.executable, "-m", *words]
            checks.append((name, subprocess.Popen(command, cwd=ROOT, start_new_session=True)))
            at_idle_priority(checks[-1][1].pid, True)
    outcomes, worst, running = [], 0, []
    with tempfile.TemporaryDirectory(prefix="pneu-tests-") as folder:
        try:
            running.append(Running(FILLING, options, Path(folder)))
            for part in FOLLOWING:
                running.append(Running(part, options, Path(folder)))
                worst = max(worst, running[-1].wait())
                outcomes += running[-1].outcome()
            at_idle_priority(running[0].process.pid, False)  # nothing is left that it could delay
            worst = max(worst, running[0].wait())
            outcomes += running[0].outcome()
            failed = [name for name, process in checks if process.wait() != 0]
        except KeyboardInterrupt:
            for process in [*(one.process for one in running), *(one for _, one in checks)]:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGINT)
                    process.wait()
            return 130
    print("\n".join(["", *summary(outcomes), *(f"failed: {name}" for name in failed)]))
    print(closing_line(outcomes))
    return 1 if failed else worst


class Running:
    """A part that runs, in a session of its own; its output is shown line by line."""

    def __init__(self, part, options, folder):
        """Start it.

        Args:
            part: The part.
            options: Options of the command line.
            folder: For its outcome.
        """
        self.part = part
        self._path = folder / f"{part.name}.json"
        self._begun_s = time.monotonic()
        marks = part.mark or " and ".join(f"not {other.mark}" for other in FOLLOWING)
        marks += " and long" if options.long else " and not long"
        command = [sys.executable, "-m", "pytest", "-m", marks, f"--outcome={self._path}"]
        command += [f"--numprocesses={part.workers}", "--dist=loadfile", "--no-loadscope-reorder"]
        command += [*part.words, *(options.paths or files_of(part))]
        share = sum(other.workers for other in PARTS[: PARTS.index(part)])
        self.process = subprocess.Popen(
            command,
            # OpenBLAS has a thread for each processor, which keeps it busy while it waits for work.
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ, SHARE: str(share)},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        at_idle_priority(self.process.pid, part.idle)
        self._shown = threading.Thread(target=self._show, daemon=True)
        self._shown.start()

    def _show(self):
        for line in self.process.stdout:
            print(f"{self.part.name}: {line}", end="", flush=True)

    def wait(self):
        """Wait for its end; return its exit status, 0 where no test was selected."""
        status = self.process.wait()
        self._shown.join()
        return 0 if status == NONE_COLLECTED else status

    def outcome(self):
        """Return what `conftest.py` wrote of it, with its name and time, in a list; maybe empty."""
        if not self._path.exists():
            return []
        outcome = json.loads(self._path.read_text(encoding="utf-8"))
        took_s = time.monotonic() - self._begun_s
        return [{**outcome, "part": self.part.name, "took_s": took_s}]


def at_idle_priority(session, idle):
    """Move processes to idle priority or back, where the system has that.

    Args:
        session: The session that they are of.
        idle: Whether they are to run only when nothing else wants to.
    """
    if not hasattr(os, "SCHED_IDLE"):
        return
    policy = os.SCHED_IDLE if idle else os.SCHED_OTHER
    for task in Path("/proc").glob("[0-9]*/task/[0-9]*"):  # each thread has its own
        try:
            if os.getsid(int(task.parts[2])) == session:
                os.sched_setscheduler(int(task.name), policy, os.sched_param(0))
        except (ProcessLookupError, PermissionError):
            continue


def files_of(part):
    """Return the paths for pytest that leave out files without a test of the part, to save time.

    Args:
        part: The part.
    """
    sources = {
        path: path.read_text(encoding="utf-8")
        for pattern in ("tests/**/test_*.py", "src/*/test/test_*.py")
        for path in sorted(ROOT.glob(pattern))
    }
    if part.mark is None:
        marks = "|".join(str(other.mark) for other in FOLLOWING)
        whole = re.compile(rf"^pytestmark = .*mark\.({marks})\b", re.M)
        return [f"--ignore={path}" for path, text in sources.items() if whole.search(text)]
    mark = re.compile(rf"mark\.{part.mark}\b")
    return [str(path) for path, text in sources.items() if mark.search(text)]


def summary(outcomes):
    """Return the last lines of a run.

    Args:
        outcomes: What `conftest.py` wrote of each part, with its name and how long it took.
    """
    lines = []
    for outcome in outcomes:
        counts = ", ".join(f"{n} {kind}" for kind, n in outcome["counts"].items() if n)
        minutes, seconds = divmod(round(outcome["took_s"]), 60)
        lines.append(f"{outcome['part']}: {counts or 'nothing'} in {minutes}:{seconds:02d}")
    for outcome in outcomes:
        lines += [f"failed: {test}" for test in outcome["failed"]]
        lines += [f"needed another try: {test}" for test in outcome["repeated"]]
    skipped = [one for outcome in outcomes for one in outcome["skipped"]]
    unproven = [one for one in skipped if one["reason"].startswith(NOT_PROVEN)]
    for one in skipped:
        if one not in unproven:
            lines.append(f"skipped: {one['test']}: {one['reason']}")
    times = {test: s for outcome in outcomes for test, s in outcome["safe_after_s"].items()}
    longest_s = max(times.values(), default=0.0)
    allowed = f"{1e3 * SAFE_WITHIN_S:.0f} ms"
    proven = f"{len(times)} tests: at most {1e3 * longest_s:.0f} ms of {allowed}"
    if unproven:
        lines += [f"{one['test']}: {one['reason']}" for one in unproven]
        lines.append(
            f"TIMES NOT PROVEN: this machine was too busy for {len(unproven)} tests, named above;"
            f" valves were safe in time in {proven}"
        )
    elif times:
        lines.append(f"safety times proven in {proven}")
    return lines


def closing_line(outcomes):
    """Return the counts of all parts in one line.

    Args:
        outcomes: As for `summary`.
    """
    counts = [outcome["counts"] for outcome in outcomes]
    failed = sum(one["failed"] + one["error"] for one in counts)
    passed, skipped = (sum(one[kind] for one in counts) for kind in ("passed", "skipped"))
    return f"tests: {passed} passed, {failed} failed, {skipped} skipped"


if __name__ == "__main__":
    sys.exit(main())
