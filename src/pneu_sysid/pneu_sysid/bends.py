# SPDX-License-Identifier: Apache-2.0
"""How much the opening curves of a rig bend, as those parts of them tell that recordings show.

A spool's port is a slot, a hole or a row of notches: its curve bends everywhere about as much as it
does anywhere. Where recordings show a curve well, what is found of it says how much it may bend
where they hardly do, near null, where a robot is held.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.curves import Bends, Ties
from pneu_sysid.gauss_newton import Estimate
from pneu_sysid.slopes import Variable

Floats = NDArray[np.float64]

STRAIGHTEST = 0.1
"""Share of what is expected beforehand that is believed at least; more than all of it never is."""
FEWEST_TOLD = 3.0
"""Of the ties so many at least have to be told by the data, or nothing is learnt of them."""
ROUNDS, AGREED = 50, 1e-3
"""Rounds at most; they end where no share changes by more than this part of itself."""


def bends_told(estimate: Estimate, variables: Sequence[Variable], ties: Ties) -> Bends:
    """How much curves bend, by the evidence for it (MacKay 1992, Neural Computation 4(3), 415).

    Of the problem as it is linear at the estimate: the standard deviation of each kind of tie is
    what the ties are, root mean square, per tie that the data tell; the others follow the prior and
    say nothing.

    Args:
        estimate: An estimate.
        variables: Its variables.
        ties: What it was tied by, with ``Bends()``.
    """
    found = np.ones(len(Bends()))
    chosen = np.flatnonzero(~estimate.at_bound)
    if not ties.matrix[:, chosen].any():
        return Bends()
    span, centre, std = np.array(
        [
            (v.upper - v.lower, v.value if v.centre is None else v.centre, v.std)
            for v in (variables[k] for k in chosen.tolist())
        ]
    ).T
    # all in shares of each variable's range, for the numerics
    jacobian = estimate.jacobian.reshape(-1, len(variables))[:, chosen] * span / estimate.weight
    prior = np.square(span / std)
    a, apart = ties.matrix[:, chosen] * span, ties.matrix @ estimate.values - ties.right
    curvature = jacobian.T @ jacobian + np.diag(prior)
    slope = jacobian.T @ estimate.residual.ravel() / estimate.weight
    slope += prior * (estimate.values[chosen] - centre) / span
    for _ in range(ROUNDS):
        by = 1.0 / found[ties.group]
        tied = a * by[:, None]
        inverse = np.linalg.pinv(curvature + tied.T @ tied, rcond=1e-12, hermitian=True)
        moved = -inverse @ (slope + tied.T @ (by * apart))
        are = apart + a @ moved
        untold = np.einsum("kp,pq,kq->k", tied, inverse, tied)
        before = found.copy()
        for group in np.unique(ties.group):
            mine = ties.group == group
            told = float(mine.sum() - untold[mine].sum())
            if told >= FEWEST_TOLD:
                share = float(np.sqrt(np.sum(are[mine] ** 2) / told))
                found[group] = np.clip(share, STRAIGHTEST, 1.0)
        if np.all(np.abs(found - before) <= AGREED * before):
            break
    return Bends(*found.tolist())
