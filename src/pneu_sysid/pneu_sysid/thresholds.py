# SPDX-License-Identifier: Apache-2.0
"""Every number that decides a verdict, with where it comes from.

``make thresholds`` halves and doubles each and shows what becomes of the verdicts.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Thresholds:
    """What decides a verdict.

    Attributes:
        significant: A strength below so many of its standard errors is not believed. Three: one in
            several hundred by chance, and tens of effects and places are tried.
        share_of_discrepancy: Squared error that an effect must take away, as a share of what the
            calibration left beyond the noise on its own recording: a part of that another recording
            shows again, and the best of tens of candidates explains some of it by chance.
        chance: ... and this share of the noise itself, squared. A calibration is called good where
            it leaves up to twice the noise on other recordings, three times the noise's squares
            more; this is a third of that.
        worth: ... and this share of the squared error there is: what is missing explains most of
            what is left, and of three equal effects each a third.
        little: A score below this share of ``worth`` is not looked into: scores are taken at one
            strength and on long cells, and miss by less than half what a refit explains.
        alike: A candidate may stand for another in the first look if their changes of the
            prediction have at least this cosine.
        contender: Candidates whose score is below this share of the best are not refitted: scores
            are taken at one strength and on long cells, and are right to some tens of percent.
        second: More is missing besides where another candidate explains, to first order, this share
            of what the best one leaves above the noise.
        tied: Two candidates are told apart where the better one's lead is more than so many of its
            standard errors.
        block: Length of the blocks of time in which errors of a model are taken to hang together,
            as a share of the horizon over which it predicts, which follows how fast a rig is.
        relative: An answer must bring the error down to where it needs no explanation, or to this
            share of what it was: effects are known in form, not in every detail of the part that
            has them.
        mostly: ... and one that takes away this share of the squared error is told too, with the
            word that more is missing besides: a measured rig is never all in its file.
        nearest: Where no answer brings it there, the nearest is added only if it explains this
            share of the squared error.
        settled: Squared error, as a multiple of what the calibration left, from which on nothing
            more is looked for.
        pulses: Effects that pulsate are tried where a line in the spectrum is so much of the
            squared error at a tap.
        unexplained: Squared error, as a multiple of what the calibration left, from which on
            something is missing although nothing in the catalogue explains it, and down to which an
            answer has to bring it: the twice that a calibration is allowed on other recordings.
        apart: A recording whose squared error over what the calibration left is this many times the
            smallest of all differs from the others.
        at_noise: Up to this many times the noise a model explains a measurement to the noise.
        accuracy: An effect in the model is right to this share of what it changes; companions of an
            effect that explain less than that are not believed.
        named: A residual is said to depend on a variable that predicts this share of its square on
            stretches it was not learnt on: there chance predicts nothing.
        most_of_it: A residual of which this share is in ...
        seldom: ... this share of the time is said to be there alone.
        of_grid: Share of the error above noise that the grid's own has to be, to be called its
            cause.
        typical: Factor on the strengths at which effects are first tried.
        most_effects: Effects that are added at most.
        finalists: Candidates that are refitted at most.
    """

    significant: float = 3.0
    share_of_discrepancy: float = 0.3
    chance: float = 1.0
    worth: float = 0.25
    little: float = 0.5
    alike: float = 0.95
    contender: float = 0.35
    second: float = 0.35
    tied: float = 3.0
    block: float = 0.2
    relative: float = 0.06
    mostly: float = 0.9
    nearest: float = 0.5
    settled: float = 1.1
    pulses: float = 0.02
    unexplained: float = 4.0
    apart: float = 3.0
    at_noise: float = 1.2
    accuracy: float = 0.02
    named: float = 0.02
    most_of_it: float = 0.8
    seldom: float = 0.15
    of_grid: float = 0.5
    typical: float = 1.0
    most_effects: int = 4
    finalists: int = 6
