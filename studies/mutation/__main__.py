# SPDX-License-Identifier: Apache-2.0
"""Put faults into the source, one at a time, and see whether the tests notice.

``record`` runs the tests once and records which lines each reaches; ``run`` draws faults and tries
those that have no outcome yet, so that an interrupted run goes on where it was; ``page`` writes
``docs/results/mutation.md``. Everything works on the last commit, in clones below ``out/mutation``.
"""

import argparse
import dataclasses
import json
import queue
import sys
import threading
from typing import Any

from rich.progress import Progress

from pneu_common.files import write_whole
from studies.mutation.faults import GROUPS, Fault, sample
from studies.mutation.page import PAGE, equivalents, page
from studies.mutation.trial import OUT, Copy, Recorded, attempt, record

RESULTS = OUT / "results.json"
STAGES = ("record", "run", "page")


def _key(fault: Fault, lines: tuple[str, str]) -> str:
    """Return what identifies a fault from one commit to the next."""
    return "\t".join([fault.path, fault.operator, str(fault.occurrence), *lines])


def run(
    faults: list[Fault], kept: dict[str, Any], again: bool, longest_s: float, workers: int
) -> None:
    """Try faults in copies side by side, and keep each outcome at once.

    Args:
        faults: The faults.
        kept: Outcomes by fault, which are added to.
        again: Whether to try survivors again.
        longest_s: How long the tests for one fault may take, s.
        workers: How many copies.
    """
    waiting: queue.SimpleQueue[tuple[str, Fault]] = queue.SimpleQueue()
    known = equivalents()
    for fault in faults:
        lines = fault.lines()
        key = _key(fault, lines)
        survivor = key in kept and kept[key]["status"] != "noticed"
        if key not in kept or (again and survivor and (fault.path, *lines) not in known):
            waiting.put((key, fault))
    copies = [Copy(f"copy{number}") for number in range(workers)]
    lock = threading.Lock()
    with Progress() as progress:
        task = progress.add_task("faults", total=waiting.qsize())

        def work(copy: Copy) -> None:
            recorded = Recorded(copies[0])
            while True:
                try:
                    key, fault = waiting.get_nowait()
                except queue.Empty:
                    return
                outcome = attempt(copy, fault, recorded.tests(fault, longest_s), recorded)
                with lock:
                    first = kept.get(key, {}).get("first", outcome.status)
                    kept[key] = {**dataclasses.asdict(outcome), "first": first}
                    write_whole(RESULTS, json.dumps(kept, indent=1))
                    before, after = key.split("\t")[3:]
                    place = f"{fault.path}:{fault.first}"
                    progress.print(f"{outcome.status}: {place}: {before} -> {after} [{outcome.by}]")
                    progress.advance(task)

        threads = [threading.Thread(target=work, args=(copy,), daemon=True) for copy in copies]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def _drawing(text: str) -> tuple[int, int]:
    """Return seed and number of a drawing."""
    seed, _, each = text.partition(":")
    return int(seed), int(each)


def main(arguments: list[str] | None = None) -> int:
    """Run the stages and return the exit status.

    Args:
        arguments: The command line; that of the process where None.
    """
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stages", nargs="*", help=f"some of {', '.join(STAGES)}; all if none")
    parser.add_argument("--files", nargs="+", default=[], help="files of new tests to record")
    parser.add_argument(
        "--draw",
        nargs="+",
        type=_drawing,
        default=[(1, 15), (2, 6)],
        metavar="SEED:EACH",
        help="how many faults of each group are drawn with a seed",
    )
    parser.add_argument(
        "--groups", nargs="+", default=list(GROUPS), choices=GROUPS, metavar="group"
    )
    parser.add_argument("--again", action="store_true", help="try survivors again")
    parser.add_argument("--longest", type=float, default=120.0, help="tests for one fault, s")
    parser.add_argument("--workers", type=int, default=2, help="trials side by side")
    options = parser.parse_args(arguments)
    stages = options.stages or STAGES
    if unknown := set(stages) - set(STAGES):
        parser.error(f"no stage {', '.join(sorted(unknown))}; there are {', '.join(STAGES)}")
    if "record" in stages:
        record(Copy("copy0"), options.files)
    kept = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.is_file() else {}
    faults = {seed: sample(seed, each, options.groups) for seed, each in options.draw}
    if "run" in stages:
        run(
            [f for of in faults.values() for f in of],
            kept,
            options.again,
            options.longest,
            options.workers,
        )
    if "page" in stages:
        rows = []
        for seed, fault in ((seed, fault) for seed, of in faults.items() for fault in of):
            before, after = fault.lines()
            key = _key(fault, (before, after))
            if key in kept:
                fields = {**dataclasses.asdict(fault), "before": before, "after": after}
                fields["line"] = fault.first  # `first` is what became of it when it was drawn
                rows.append({**fields, "seed": seed, **kept[key]})
        PAGE.parent.mkdir(parents=True, exist_ok=True)
        write_whole(PAGE, page(rows, Recorded(Copy("copy0")).totals(), dict(options.draw)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
