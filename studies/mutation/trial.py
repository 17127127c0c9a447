# SPDX-License-Identifier: Apache-2.0
"""Copies of the repository: record what each test reaches, put a fault in, run the tests for it."""

import ast
import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path

import coverage

from studies.digest import ROOT
from studies.mutation import recorder
from studies.mutation.faults import Fault

OUT = ROOT / "out" / "mutation"
LONGEST_S = 300.0
"""No test takes longer, s."""
PATIENCE_S = 120.0
"""A trial that takes so much longer than its tests took has a fault that hangs, s."""
OF_KERNELS = ("src/pneu_sim/test", "tests/test_gas_solver.py")
"""Where tests of kernels are, which are recorded with these uncompiled."""
CONFIG = """
[run]
source_dirs =
{sources}
data_file = {data}
branch = true
parallel = true
sigterm = true
context = ${{{test}-}}
disable_warnings = no-data-collected,module-not-imported,context-collision
"""
START = "import coverage\ncoverage.process_startup()\n"


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What became of a fault.

    Attributes:
        status: `noticed`, `survived`, or `not run` where no test reaches the fault.
        by: The first test that failed, or why else it was noticed.
        tests: How many tests were chosen.
        took_s: How long the trial took, s.
    """

    status: str
    by: str
    tests: int
    took_s: float


class Copy:
    """A clone of the repository's last commit, whose sources are the ones imported."""

    def __init__(self, name: str) -> None:
        """Make or renew the clone, with the kernels that are compiled already.

        Args:
            name: Of its folder.
        """
        self.root = OUT / name
        if not (self.root / ".git").is_dir():
            OUT.mkdir(parents=True, exist_ok=True)
            _git(ROOT, "clone", "--quiet", str(ROOT), str(self.root))
        _git(self.root, "fetch", "--quiet", "origin", "HEAD")
        _git(self.root, "reset", "--quiet", "--hard", "FETCH_HEAD")
        _git(self.root, "clean", "--quiet", "-df")
        for kernel in ROOT.glob("src/**/*.nb[ci]"):  # valid for the same content, wherever it lies
            kept = self.root / kernel.relative_to(ROOT)
            if not kept.exists():
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(kernel, kept)
        self.variables = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, sorted((self.root / "src").iterdir()))),
            "OPENBLAS_NUM_THREADS": "1",
            # A file that changes twice within a second must not be taken for the first version.
            "PYTHONDONTWRITEBYTECODE": "1",
        }

    def pytest(
        self, words: list[str], timeout_s: float, **variables: str
    ) -> tuple[int | None, str]:
        """Run tests; end all their processes after a time.

        Args:
            words: For pytest.
            timeout_s: The time, s.
            variables: Further environment variables.

        Returns:
            The exit status, None after the timeout; what pytest printed.
        """
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words],
            cwd=self.root,
            env={**self.variables, **variables},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        try:
            text, _ = process.communicate(timeout=timeout_s)
            return process.returncode, text
        except subprocess.TimeoutExpired:
            return None, ""
        finally:
            # Nodes have sessions of their own; what lives still has the copy as its folder.
            for entry in Path("/proc").glob("[0-9]*"):
                try:
                    if (entry / "cwd").readlink() == self.root and int(entry.name) != os.getpid():
                        os.kill(int(entry.name), signal.SIGKILL)
                except (OSError, ProcessLookupError):
                    continue
            process.wait()


def _git(folder: Path, *words: str) -> None:
    subprocess.run(["git", "-C", str(folder), *words], check=True)


def record(copy: Copy, files: list[str]) -> None:
    """Run the tests and record what they reach.

    Those of kernels are run a second time, these not compiled, as coverage does not see into
    machine code; each is ended after a while.

    Args:
        copy: Where.
        files: Of new tests, which are recorded besides those before; none stand for all tests.
    """
    folder = OUT / "recorded"
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.iterdir() if not files else ():
        old.unlink()
    packages = sorted(copy.root.glob("src/*/pneu_*"))
    config = CONFIG.format(
        sources="\n".join(f"    {package}" for package in packages),
        data=folder / "coverage",
        test=recorder.TEST,
    )
    (folder / "config").write_text(config, encoding="utf-8")
    (folder / "sitecustomize.py").write_text(START, encoding="utf-8")
    variables = {
        "PYTHONPATH": os.pathsep.join([str(folder), copy.variables["PYTHONPATH"]]),
        "COVERAGE_PROCESS_START": str(folder / "config"),
    }
    words = ["-p", "studies.mutation.recorder"]
    clock = {recorder.DURATIONS: str(folder)}
    two = ["--numprocesses=2", "--dist=loadfile", "-m", "not long"]
    copy.pytest([*words, *two, *files], 7200.0, **variables, **clock)
    # (a test that is ended may be at an instruction without a line, which tracebacks cannot show)
    two[-1] += " and not realtime"
    uncompiled = {"NUMBA_DISABLE_JIT": "1", recorder.LIMIT: "1"}
    if of_kernels := [file for file in files or OF_KERNELS if file.startswith(OF_KERNELS)]:
        words += [*two, "--tb=no", *of_kernels]
        copy.pytest(words, 7200.0, **variables, **uncompiled)
    combined = coverage.Coverage(config_file=str(folder / "config"))
    if files:
        combined.load()
    combined.combine([str(folder)])
    combined.save()


class Recorded:
    """Which tests reach which line, and how long they take."""

    def __init__(self, copy: Copy) -> None:
        """Read what was recorded.

        Args:
            copy: Where it was.
        """
        folder = OUT / "recorded"
        self._root = copy.root
        self._data = coverage.CoverageData(basename=str(folder / "coverage"))
        self._data.read()
        self.durations: dict[str, tuple[float, bool]] = {}
        for file in folder.glob("*.json"):
            self.durations |= json.loads(file.read_text(encoding="utf-8"))
        self._of_file: dict[str, list[str]] = defaultdict(list)
        for test in self.durations:
            self._of_file[test.partition("::")[0]].append(test)

    def tests(self, fault: Fault, longest_s: float) -> list[str]:
        """Return the tests that reach a fault: those of its own package first, then by duration.

        Args:
            fault: The fault. Lines that an import runs are recorded for whoever imports first; for
                those all tests count that run any line of the file, and of files that name it.
            longest_s: No more tests are chosen than took so long, when they were recorded, s.
        """
        reached = self._data.contexts_by_lineno(str(self._root / fault.path))
        names = self._known(reached, range(fault.first, fault.last + 1))
        if not _in_function((self._root / fault.path).read_text(encoding="utf-8"), fault.first):
            names |= self._known(reached, reached)
            module = fault.path.split("/", 2)[2].removesuffix(".py").replace("/", ".")
            module = module.removeprefix("pneu_runtime.embedded.").removesuffix(".__init__")
            above, _, name = module.rpartition(".")
            named = re.compile(
                rf"\b{re.escape(module)}\b|from {re.escape(above)} import .*\b{name}\b"
            )
            for file, tests in self._of_file.items():
                path = self._root / file
                if path.is_file() and named.search(path.read_text(encoding="utf-8")):
                    names.update(tests)
        package = fault.path.split("/")[1]

        def turn(name: str) -> tuple[bool, float]:
            return not name.startswith(f"src/{package}/"), self.durations[name][0]

        chosen: list[str] = []
        total_s = 0.0
        for name in sorted(names, key=turn):
            total_s += self.durations[name][0]
            if total_s > longest_s and chosen:
                break
            chosen.append(name)
        return chosen

    def totals(self) -> dict[str, dict[str, int]]:
        """Return the totals of coverage of each file, as coverage reports them in JSON."""
        measured = coverage.Coverage(config_file=str(OUT / "recorded" / "config"))
        measured.load()
        report = OUT / "coverage.json"
        measured.json_report(outfile=str(report), ignore_errors=True)
        files = json.loads(report.read_text(encoding="utf-8"))["files"]
        found = {}
        for name, of in files.items():
            found[Path(name).resolve().relative_to(self._root).as_posix()] = of["summary"]
        return found

    def _known(self, reached: Mapping[int, list[str]], lines: Iterable[int]) -> set[str]:
        """Return tests that reach lines; a process they share stands for all tests of a file."""
        found: set[str] = set()
        for line in lines:
            for context in reached.get(line, ()):
                name = context.removeprefix(recorder.PROCESS)
                if name not in self.durations:  # an import, before the first test
                    continue
                shared = name != context and self.durations[name][1]
                found.update(self._of_file[name.partition("::")[0]] if shared else {name})
        return found


def _in_function(source: str, line: int) -> bool:
    """Return whether a line is in the body of a function, and not only run by an import."""
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    return any(
        isinstance(node, functions) and node.body[0].lineno <= line <= (node.end_lineno or 0)
        for node in ast.walk(ast.parse(source))
    )


def attempt(copy: Copy, fault: Fault, tests: list[str], recorded: Recorded) -> Outcome:
    """Put a fault into a copy and run tests until one fails.

    Args:
        copy: The copy.
        fault: The fault.
        tests: Names of the tests.
        recorded: For their durations.
    """
    if not tests:
        return Outcome("not run", "", 0, 0.0)
    begun_s = time.monotonic()
    target = copy.root / fault.path
    before, after = fault.texts(copy.root)
    target.write_text(after, encoding="utf-8")
    status, by = "survived", ""
    try:
        # Tests against the clock may fail as the machine is busy: they have three tries.
        for clock, words in ((False, ["-x"]), (True, ["-x", "--reruns=2"])):
            chosen = [one for one in tests if recorded.durations[one][1] == clock]
            if not chosen or status == "noticed":
                continue
            listed = OUT / f"{copy.root.name}.txt"
            listed.write_text("\n".join(chosen), encoding="utf-8")
            expected_s = sum(recorded.durations[one][0] for one in chosen)
            code, text = copy.pytest([*words, f"@{listed}"], 3.0 * expected_s + PATIENCE_S)
            if code is None:
                status, by = "noticed", "the tests hang"
            elif code == 4 and "not found: " in text:
                # Either a test is no longer there, or its file cannot be imported with the fault.
                target.write_text(before, encoding="utf-8")
                code, text = copy.pytest(["--collect-only", f"@{listed}"], LONGEST_S)
                if code != 0:
                    raise RuntimeError(f"record the tests again: {text[-300:]}")
                status, by = "noticed", "the tests cannot be imported"
            elif code not in (0, 5):
                failed = [one for one in text.splitlines() if one.startswith(("FAILED", "ERROR"))]
                by = (failed or ["the tests cannot be run"])[0].partition(" - ")[0]
                status = "noticed"
        if by.startswith(("FAILED", "ERROR")):
            # A test that fails without the fault as well has noticed nothing.
            target.write_text(before, encoding="utf-8")
            code, _ = copy.pytest([by.split(" ", 1)[1]], LONGEST_S)
            if code != 0:
                status, by = "not run", f"without the fault, too: {by}"
    finally:
        target.write_text(before, encoding="utf-8")
    return Outcome(status, by, len(tests), time.monotonic() - begun_s)
