# SPDX-License-Identifier: Apache-2.0
"""Run tests: first what computes, then what runs against the clock; say what was left out.

Without an option those that together take some minutes, with `--long` those marked long.

Another user may stall a machine, so what runs against the clock has three tries. The last lines say
how many tests passed, which were skipped and why, which needed another try, and whether the times
in which valves have to be safe were proven: nothing is subtracted from them, so on a machine too
busy to keep them they are not, and this is said. Exit status 1 where a test fails.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PARTS = {
    "what computes": ["-m", "not realtime and {which}"],
    "what runs against the clock": ["-m", "realtime and {which}", "--reruns", "2"],
}
TOGETHER = ["--dist=loadfile", "--no-loadscope-reorder"]
PROCESSES = {"what computes": 3, "what runs against the clock": 2}
"""Side by side. What computes waits now and then; what runs against the clock wants room."""
NONE_COLLECTED = 5

sys.path.insert(0, str(ROOT))
from tests.measured import NOT_PROVEN, SAFE_WITHIN_S  # noqa: E402
from tests.parts import MIXED, REALTIME  # noqa: E402


def main():
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("paths", nargs="*", help="tests to run instead of all of them")
    parser.add_argument("--long", action="store_true", help="those that are marked long")
    options = parser.parse_args()
    which = "long" if options.long else "not long"
    outcomes, worst = [], 0
    with tempfile.TemporaryDirectory(prefix="pneu-tests-") as folder:
        for number, (part, words) in enumerate(PARTS.items()):
            path = Path(folder) / f"{number}.json"
            print(f"\n{part}", flush=True)
            begun_s = time.monotonic()
            words = [word.format(which=which) for word in words]
            command = [sys.executable, "-m", "pytest", *words, *TOGETHER, f"--outcome={path}"]
            command += [f"--numprocesses={PROCESSES[part]}", *(options.paths or files_of(part))]
            status = subprocess.run(command, check=False).returncode
            if status in (2, 130):  # interrupted
                return status
            if status != NONE_COLLECTED:
                worst = max(worst, status)
            if path.exists():
                outcome = json.loads(path.read_text(encoding="utf-8"))
                outcomes.append({**outcome, "part": part, "took_s": time.monotonic() - begun_s})
    print("\n".join(["", *summary(outcomes)]))
    return worst


def files_of(part):
    """Return words for pytest that leave out the files without a test of the part, to save time.

    Args:
        part: Name of the part.
    """
    if part == "what runs against the clock":
        return _files(REALTIME + MIXED)
    return [f"--ignore={file}" for file in _files(REALTIME)]


def _files(beginnings):
    """Return the paths that begin so, from the top of the repository."""
    found = [path for start in beginnings for path in ROOT.glob(f"{start.rstrip('/')}*")]
    return sorted(str(path.relative_to(ROOT)) for path in found)


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


if __name__ == "__main__":
    sys.exit(main())
