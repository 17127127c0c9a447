# SPDX-License-Identifier: Apache-2.0
"""Terms of the gas's equations besides what flows: those of the package, and anybody's.

A term is a pass of its own that adds to the state of slots and chambers, or takes from it, once a
step, before what the faces carry is added. It is given a `Term`: the slots it acts on, and numbers
for each and every rig. Rows whose numbers are zero are those that a rig does not have.

    @branching
    def mine(gas, dt, cells, chambers, term): ...
"""

from collections.abc import Callable, Sequence
from typing import Any

from pneu_sim.compiling import sequence, uncached
from pneu_sim.kernel.leaks import leak


@sequence
def act(gas, dt, cells, chambers, terms):
    """All terms of the package, each with what it acts on.

    Args:
        gas: The gas.
        dt: Step, s.
        cells: All slots.
        chambers: Chambers.
        terms: Tuple of `Term`.
    """
    leak(gas, dt, cells, chambers, terms[0])


def acting(more: Sequence[Callable[..., Any]]) -> Any:
    """The terms of the package and some besides, as one pass that is given the terms of all.

    Args:
        more: Compiled terms.
    """
    names = {f"_term_{k}": term for k, term in enumerate(more, start=1)}
    lines = ["def act_all(gas, dt, cells, chambers, terms):"]
    lines += ["    _package(gas, dt, cells, chambers, terms)"]
    lines += [
        f"    {name}(gas, dt, cells, chambers, terms[{k}])" for k, name in enumerate(names, start=1)
    ]
    scope: dict[str, Any] = {"_package": act, **names}
    exec("\n".join(lines), scope)
    return uncached(scope["act_all"])
