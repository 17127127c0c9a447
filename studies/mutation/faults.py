# SPDX-License-Identifier: Apache-2.0
"""Possible faults of the source, and a sample of them.

The order in which faults are drawn is that of a digest of the seed and of the fault itself, and
not of its place in a list: a change in one file leaves the faults drawn in all others.
"""

import ast
import dataclasses
import difflib
import hashlib
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code

from studies.digest import ROOT
from studies.mutation.operators import CLASSES, OPERATORS

GROUPS: dict[str, str] = {
    "kernels": r"pneu_sim/(kernel/|riemann|valve|spool|switching|lumped/filling)",
    "safety": r"pneu_hw_bridge/(safety/|link|stopping|stop_command)",
    "registers": r"pneu_hw_bridge/(registers|modbus)/",
    "readers": r"pneu_sysid/(records/|units|sensor_units|parameter_units)|pneu_graph/bag/",
    "estimation": r"pneu_sysid/(gauss_newton|problem|parameters|fit|fit_step|stages|uncertainty"
    r"|start|scale|slopes|together|last_steps|cells|compare|bends|curves|shift)\.py",
    "verdicts": r"pneu_sysid/(diagnose|learn|refits|trials|evidence|thresholds|standing|left_open"
    r"|nuisance|candidates|along|sites|heading|words|bench|shortfall|dependence|regimes)\.py",
    "pneu_common": r"pneu_common/",
    "pneu_runtime": r"pneu_runtime/",
    "pneu_graph": r"pneu_graph/",
    "pneu_sim": r"pneu_sim/",
    "pneu_hw_bridge": r"pneu_hw_bridge/",
    "pneu_sysid": r"pneu_sysid/",
    "pneu_policy": r"pneu_policy/",
    "pneu_workbench": r"pneu_workbench/",
}
"""Groups of files by a pattern of their path; the first that fits counts."""
CRITICAL = ("safety", "registers", "readers", "estimation", "verdicts")
"""Groups in which nine faults of ten are to be noticed."""


@dataclasses.dataclass(frozen=True)
class Fault:
    """One change of the source.

    Attributes:
        group: Group of its file.
        kind: Class of the operator.
        path: File, from the root of the repository.
        operator: Name of the operator.
        occurrence: Which place in the file, as Cosmic Ray counts them for this operator.
        first: First line that it changes, from 1.
        last: Last line that it changes.
    """

    group: str
    kind: str
    path: str
    operator: str
    occurrence: int
    first: int
    last: int

    def texts(self, root: Path = ROOT) -> tuple[str, str]:
        """Return the source before and after.

        Args:
            root: Of the repository or a copy of it.
        """
        before = (root / self.path).read_text(encoding="utf-8")
        after = mutate_code(before, OPERATORS[self.operator], self.occurrence)
        assert after is not None, self
        return before, after

    def possible(self) -> bool:
        """Return whether it is Python, and changes what is done.

        An assertion tells mypy the type, and `frozen=True` says what no code does. Cosmic Ray's
        operators fail where an exception is named with its module.
        """
        try:
            before, after = self.texts()
        except AttributeError:
            return False
        if before.splitlines()[self.first - 1].lstrip().startswith(("assert", "@dataclass")):
            return False
        try:
            ast.parse(after)
        except SyntaxError:
            return False
        return True

    def lines(self) -> tuple[str, str]:
        """Return the lines that change, before and after, each in one line of text."""
        before, after = (text.splitlines() for text in self.texts())
        old, new = [], []
        matcher = difflib.SequenceMatcher(None, before, after, autojunk=False)
        for tag, a, b, c, d in matcher.get_opcodes():
            if tag != "equal":
                old += before[a:b]
                new += after[c:d]
        return " ".join(" ".join(old).split()), " ".join(" ".join(new).split())


@cache
def sources() -> dict[str, str]:
    """Return the group of each file that faults may be put into, by its path."""
    found = {}
    for package in sorted((ROOT / "src").iterdir()):
        for file in sorted((package / package.name).rglob("*.py")):
            path = file.relative_to(ROOT).as_posix()
            for group, pattern in GROUPS.items():
                if re.search(pattern, path):
                    found[path] = group
                    break
    return found


def faults_of(path: str) -> Iterator[Fault]:
    """Yield all possible faults of a file, in the order of Cosmic Ray's walk.

    Args:
        path: The file, from the root of the repository.
    """
    counts = dict.fromkeys(OPERATORS, 0)
    kinds = [(kind, name) for kind, names in CLASSES.items() for name in names]
    for node in ast_nodes(get_ast((ROOT / path).read_text(encoding="utf-8"))):
        for kind, name in kinds:
            for start, end in OPERATORS[name].mutation_positions(node):
                yield Fault(sources()[path], kind, path, name, counts[name], start[0], end[0])
                counts[name] += 1


def sample(seed: int, each: int, groups: Iterable[str]) -> list[Fault]:
    """Draw faults: as many of each group, its classes in turn.

    Args:
        seed: Of the drawing.
        each: How many per group.
        groups: Names of the groups.
    """
    drawn: list[Fault] = []
    for group in groups:
        by_kind: dict[str, list[tuple[str, Fault]]] = {kind: [] for kind in CLASSES}
        for path in (path for path, of in sources().items() if of == group):
            text = (ROOT / path).read_text(encoding="utf-8").splitlines()
            for fault in faults_of(path):
                # Code above does not change what is drawn here, but the line itself does.
                key = (seed, path, fault.operator, text[fault.first - 1], fault.occurrence)
                rank = hashlib.sha256(repr(key).encode()).hexdigest()
                by_kind[fault.kind].append((rank, fault))
        queues = [sorted(ranked, key=lambda one: one[0]) for ranked in by_kind.values()]
        chosen: list[Fault] = []
        for turn in range(max(map(len, queues))):
            candidates = [queue[turn][1] for queue in queues if turn < len(queue)]
            chosen += [fault for fault in candidates if fault.possible()]
            if len(chosen) >= each:
                break
        drawn += chosen[:each]
    return drawn
