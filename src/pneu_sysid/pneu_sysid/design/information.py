# SPDX-License-Identifier: Apache-2.0
"""What pieces of a recording tell: of parameters, and of what sets candidates apart.

Each piece is one matrix of inner products of all that may change the prediction within it; what
several pieces tell together is the sum of theirs. Fisher information and the squared distance
between two models are small linear algebra on that sum.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from pneu_sim.rig import with_parameters
from pneu_sim.rig.schema import FitParameter, Rig
from pneu_sysid.cells import own_share, weights_of
from pneu_sysid.curves import Mirrors, curve_ties
from pneu_sysid.design.hypotheses import Hypothesis
from pneu_sysid.evidence import blocks_of
from pneu_sysid.parameters import one_each, rig_at, variables_of
from pneu_sysid.problem import Problem
from pneu_sysid.refits import effect_variables
from pneu_sysid.slopes import Variable, looked_along
from pneu_sysid.thresholds import Thresholds

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

UNFORESEEN = 1.0
"""Share of what cells get wrong that is not foreseen, as the rig is not known: all. A reading of
which they get more wrong than the noise tells a fit little that it can trust; plans that lived on
such fronts (40 to 80 deviations) led fits into the error of their own cells."""
RIDGE = 1e-9
"""Of the largest inner product: what is known no better than to rounding counts for nothing."""


@dataclass(frozen=True)
class Columns:
    """Where what changes the prediction stands in the matrices.

    Attributes:
        change: Per hypothesis the column of what it changes at what was found.
        own: Per hypothesis the columns of what its own numbers change about that.
        parameters: Columns of the parameters, each per standard deviation of what was known.
        doubtful: Columns of what the model may get wrong in a way that is known, one for each
            sensor: what longer cells get wrong, about as much as its own do near fronts.
    """

    change: list[int]
    own: list[list[int]]
    parameters: list[int]
    doubtful: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class Information:
    """What pieces tell.

    Attributes:
        columns: What stands where.
        grams: (n_pieces, 2, C, C) inner products, in noise deviations; and how they scatter, what
            a model leaves going along with them: the same where that is noise from reading to
            reading, more where it lasts.
        variables: The parameters.
        known_std: (P,) what was known of each before, in its own variable.
        prior: (P, P) information that was there before, per these: of each, and of opening curves,
            which bend only so much.
        doubt: One deviation of what is doubtful, of what longer cells get wrong.
    """

    columns: Columns
    grams: Floats = field(repr=False)
    variables: list[Variable] = field(repr=False)
    known_std: Floats = field(repr=False)
    prior: Floats = field(repr=False)
    doubt: float = 1.0

    def covariance(self, gram: Floats) -> Floats:
        """(P, P) covariance of the parameters after a fit, per standard deviation known before.

        A fit takes what is left for noise, and that may last (the covariance of Huber 1967). What
        is doubtful is estimated besides (`cells`).

        Args:
            gram: (2, C, C) sum over pieces.
        """
        (inner, scatter), known = self._fitted(gram)
        inverse = np.linalg.inv(inner + known)
        whole = inverse @ (scatter + known) @ inverse
        count = len(self.columns.parameters)
        return np.asarray(whole[:count, :count])

    def _fitted(self, grams: Floats) -> tuple[Floats, Floats]:
        """Inner products of what a fit estimates, and (F, F) what is known of it before.

        Args:
            grams: (..., C, C).
        """
        at = [*self.columns.parameters, *self.columns.doubtful]
        known = block_diag(self.prior, np.eye(len(self.columns.doubtful)) / self.doubt**2)
        return grams[..., at, :][..., at], known

    def found(self) -> Floats:
        """(P,) standard errors that a fit is expected to find, as shares of what was known before.

        A fit tells them by leaving out one stretch after the other, each with what it alone tells
        (`gauss_newton.left_out_moves`). Of noise that is, on average, how much less certain all is
        without each: the sum of ``(H - o)^-1 o H^-1`` over stretches of information ``o``, all
        having ``H``. It is no less than what noise makes of a fit to all.

        Pieces are to be the stretches.
        """
        stretches, known = self._fitted(self.grams)
        whole = stretches[:, 0].sum(axis=0) + known
        inverse = np.linalg.inv(whole)
        variance = np.diag(inverse @ known @ inverse).copy()
        count = len(stretches)
        for own, scatter in stretches:
            moved = np.linalg.solve(whole - own, scatter @ inverse)
            variance += (count - 1) / count * np.maximum(np.diag(moved), 0.0)
        numbers = len(self.columns.parameters)
        least = np.diag(self.covariance(self.grams.sum(axis=0)))
        return np.asarray(np.sqrt(np.maximum(variance[:numbers], least)))

    def log_determinant(self, gram: Floats) -> float:
        """Logarithm of how much smaller the volume of what is possible becomes (D-optimality).

        Args:
            gram: (2, C, C) sum over pieces.
        """
        return -float(np.linalg.slogdet(self.covariance(gram))[1])

    def residual(self, gram: Floats, true: int, other: int) -> Floats:
        """(C,) combination of columns that is left between two hypotheses (T-optimality).

        The true one, less the other with its own numbers and the parameters fitted to it.

        Args:
            gram: (2, C, C) sum over pieces.
            true: Which is the case.
            other: Which is fitted.
        """
        gram = gram[0]
        out = np.zeros(gram.shape[0])
        out[self.columns.change[true]] = 1.0
        out[self.columns.change[other]] = -1.0
        free = [*self.columns.own[other], *self.columns.parameters]
        if free:
            inner = gram[np.ix_(free, free)].copy()
            # base parameters were known to a deviation; of a candidate's numbers nothing was
            known = slice(len(self.columns.own[other]), None)
            inner[known, known] += self.prior
            inner[np.diag_indices(len(free))] += RIDGE * max(float(np.trace(gram)), 1e-12)
            out[free] = -np.linalg.solve(inner, gram[free] @ out)
        return out

    def lead(self, gram: Floats, one: int, other: int) -> float:
        """By how many standard errors the right one of two is expected to lead, whichever it is.

        Two models whose predictions differ by D deviations of noise leave squares that differ by
        D^2, which noise scatters by 2 D, what a calibration left besides by more, since it lasts,
        and what is doubtful by as much as it goes along with D: so it is judged afterwards
        (`evidence.lead`).

        Args:
            gram: (2, C, C) sum over pieces.
            one: One of them.
            other: The other.
        """
        leads = []
        for true, fitted in ((one, other), (other, one)):
            left = self.residual(gram, true, fitted)
            square = max(float(left @ gram[0] @ left), 0.0)
            chance = max(float(left @ gram[1] @ left), square)
            chance += float(np.sum(gram[0][self.columns.doubtful] @ left)) ** 2
            leads.append(0.5 * square / np.sqrt(chance) if chance > 0.0 else 0.0)
        return float(min(leads))


def information_of(
    problem: Problem,
    rig: Rig,
    hypotheses: Sequence[Hypothesis],
    parameters: Sequence[FitParameter],
    edges_s: Floats | None,
    lasting: Mapping[str, float],
    mirrors: Mirrors | None = None,
    progress: Callable[[float], None] | None = None,
    looks: int = 0,
) -> Information:
    """What each piece of a recording that is foreseen tells.

    Args:
        problem: The recording as the rig alone predicts it.
        rig: The rig.
        hypotheses: What it may lack.
        parameters: Its numbers that are not known exactly.
        edges_s: (n_pieces + 1,) where pieces begin and end, s; None takes each stretch for one.
        lasting: Per sensor the share of the square of what is taken for noise that lasts, see
            `foreseen.lasting_share`.
        mirrors: Opening curves that are about the mirrors of others.
        progress: Called with the fraction done.
        looks: How often what the recording hardly shows of the numbers is looked along, as a fit
            does (`slopes.looked_along`).
    """
    listed = one_each(list(parameters), [r.name for r in problem.recordings])
    variables = variables_of(rig, listed) if listed else []
    known = np.array([v.known_std for v in variables])
    x = np.array([v.value for v in variables])
    rigs, of = [rig], []  # (rig at the other end, step) by column
    change: list[int] = []
    own: list[list[int]] = []
    column = 0
    for one in hypotheses:
        at = len(rigs)
        rigs.append(one.rig)
        of.append((at, 0, 1.0))
        change.append(column)
        column += 1
        mine = []
        for v in effect_variables(one.rig, len(one.rig.effects) - 1):
            step = v.step if v.value + v.step <= v.upper else -v.step
            of.append((len(rigs), at, step))
            rigs.append(with_parameters(_with_default(one.rig, v), {v.name: v.value + step}))
            mine.append(column)
            column += 1
        own.append(mine)
    numbers = []
    for k, v in enumerate(variables):
        step = v.step if x[k] + v.step <= v.upper else -v.step
        y = x.copy()
        y[k] += step
        of.append((len(rigs), 0, step / known[k]))
        rigs.append(rig_at(rig, listed, y))
        numbers.append(column)
        column += 1
    doubtful = [] if problem.grid_pa is None else [column + k for k in range(len(problem.taps))]
    readings = problem.simulate(rigs, progress, strict=False).readings
    missing = ~np.isfinite(problem.target())
    columns = np.empty((problem.stretches, missing[0].size, column + len(doubtful)))
    if problem.grid_pa is not None:
        wrong = np.where(missing, 0.0, problem.grid_pa / problem.noise_pa)
        for k, at in enumerate(doubtful):
            alone = np.where(np.arange(len(problem.taps)) == k, np.nan_to_num(wrong), 0.0)
            columns[:, :, at] = alone.reshape(problem.stretches, -1)
    for c, (end, start, step) in enumerate(of):
        diff = (readings[end] - readings[start]) / (problem.noise_pa * step)
        diff[missing] = 0.0
        columns[:, :, c] = np.nan_to_num(diff.reshape(problem.stretches, -1))
    if looks and numbers:

        def in_noise(found: Floats) -> Floats:
            units = np.where(missing, 0.0, found / problem.noise_pa)
            return np.nan_to_num(units).reshape(-1, problem.stretches, missing[0].size)

        def readings_at(points: Sequence[Floats]) -> Floats:
            there = [rig_at(rig, listed, y) for y in points]
            return in_noise(problem.simulate(there, None, strict=False).readings)

        here = in_noise(readings[:1])[0]
        j = columns[:, :, numbers] / known
        j = looked_along(readings_at, x, here, j, variables, looks)
        columns[:, :, numbers] = j * known
    longer = (problem.dx_m or rig.grid.dx_m) / rig.grid.dx_m
    doubt = own_share(longer) if doubtful else 1.0
    if doubtful and not hypotheses:  # a verdict has all readings count alike
        wrong_of_each = doubt * columns[:, :, doubtful].sum(axis=2)
        columns *= weights_of(wrong_of_each, UNFORESEEN)[:, :, None]
    share = np.array([lasting.get(name, 0.0) for name in problem.taps])
    per_stretch = np.stack(
        [
            np.einsum("smi,smj->sij", columns, columns, optimize=True),
            _scatter(columns, share, blocks_of(problem, Thresholds().block)),
        ],
        axis=1,
    )
    totals = per_stretch
    if edges_s is not None:
        middle = problem.span_s.mean(axis=1)
        piece = np.clip(np.searchsorted(edges_s, middle, "right") - 1, 0, edges_s.size - 2)
        totals = np.zeros((edges_s.size - 1, *per_stretch.shape[1:]))
        np.add.at(totals, piece, per_stretch)
    ties = curve_ties(rig, listed, mirrors).matrix * known
    prior = np.eye(known.size) + ties.T @ ties
    layout = Columns(change, own, numbers, doubtful)
    return Information(layout, totals, variables, known, prior, doubt)


def _scatter(columns: Floats, share: Floats, blocks: Ints) -> Floats:
    """(n_stretches, C, C) how inner products scatter, what is left being part noise, part lasting.

    Args:
        columns: (n_stretches, m, C) in noise deviations; of m readings those of a sensor are every
            so many.
        share: (n_taps,) of the square of what is left, how much lasts through a block.
        blocks: (n_stretches, m) block of time of each reading.
    """
    each = np.tile(np.sqrt(1.0 - share), columns.shape[1] // share.size)[:, None]
    noise = columns * each
    out = np.einsum("smi,smj->sij", noise, noise, optimize=True)
    for k in np.flatnonzero(share > 0.0):
        own, of = columns[:, k :: share.size], blocks[:, k :: share.size]
        stretch = np.broadcast_to(np.arange(len(of))[:, None], of.shape)
        pairs = np.stack([stretch.ravel(), of.ravel()])
        found, where = np.unique(pairs, axis=1, return_inverse=True)
        sums = np.zeros((found.shape[1], columns.shape[2]))
        np.add.at(sums, where.ravel(), own.reshape(-1, columns.shape[2]))
        np.add.at(out, found[0], share[k] * np.einsum("bi,bj->bij", sums, sums))
    return out


def _with_default(rig: Rig, variable: Variable) -> Rig:
    """The rig with a number of an effect written down, that was left at its default."""
    _, index, _, name = variable.name.split(".")
    out = rig.model_copy(deep=True)
    out.effects[int(index)].parameters.setdefault(name, variable.value)
    return out
