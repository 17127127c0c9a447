# SPDX-License-Identifier: Apache-2.0
"""Predictive control of a pressure or a joint: an observer, and plans from the state it sees.

In every period the observer is led on by the readings, the voltage that was decided before goes
out, and what comes after it is planned from the state as it now is. So a plan has a period to be
made in. One that is not ready by then is not waited for: the one before goes on, and the late one
is taken where it then fits.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_policy.control.horizon import Aim
from pneu_policy.control.identity import OF_LINES, check_same, rig_identity
from pneu_policy.control.in_force import InForce
from pneu_policy.control.late import with_delay
from pneu_policy.control.planning import Beside, Here, Planner, Planning, Request
from pneu_policy.control.predictive_settings import PredictiveSettings
from pneu_sim.observe.observer import Observer
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

PREVIEW_STEP_S = 0.01
"""Targets ahead are asked for so closely, s."""
LONGEST_S = 0.1
"""A step so long after the last begins anew, s."""
EARLY = 0.25
"""A step that is early by less than this share of a period is that of the next one."""
KEPT = 6000
"""So many of the latest times that plans took are kept."""


@dataclass(frozen=True)
class Course:
    """A plan over time.

    Attributes:
        begin_s: When it begins, s.
        volts: (knots,) V.
    """

    begin_s: float
    volts: Floats


@dataclass(frozen=True)
class Heard:
    """What a step was told.

    Attributes:
        readings: By sensor, Pa, rad or m.
        targets: At the times ahead, likewise.
        time_s: When it was read, s.
        since_s: Since what was read before, s.
        late_s: How old it was, s.
    """

    readings: Mapping[str, float]
    targets: Sequence[float]
    time_s: float
    since_s: float
    late_s: float


class PredictiveController:
    """Plans ahead on the model of a rig.

    Attributes:
        name: What to call it.
        tap: Tap whose pressure it controls, or encoder.
        taps: Taps and encoders it is told.
        preview_s: Times ahead at which it is told the target, s.
        period_s: Time from one step to the next, s.
        rig: The model.
        settings: How plans are made.
        observer: What follows the state.
        planning: Who makes plans; the controller's own thread unless it is told otherwise.
        deferred: Whether somebody else calls `follow` once the voltage has gone out.
        took_s: How long the latest plans took, s.
        asked: Plans that were wanted.
        missed: Those of them that were not made, as the one before was not ready in time.
    """

    def __init__(
        self,
        rig: Rig,
        tap: str = "end",
        taps: Sequence[str] | None = None,
        settings: PredictiveSettings | None = None,
        name: str = "predictive",
        signs: Mapping[str, float] | None = None,
    ) -> None:
        """Builds the model.

        Args:
            rig: The rig, calibrated.
            tap: Tap whose pressure it controls, or encoder; it need not be one that it is told.
            taps: Taps and encoders it is told; None is all taps.
            settings: How plans are made.
            name: What to call it.
            signs: By command which side of the null it is on; see `horizon.Aim`.

        Raises:
            InputError: The rig has no such sensor, other commands, or cannot be followed.
        """
        s = self.settings = settings or PredictiveSettings()
        self.name, self.tap, self.period_s, self.rig = name, tap, s.period_s, rig
        self.taps = tuple(rig.taps if taps is None else taps)
        self._aim = Aim(tap, self.taps, dict(signs or {}))
        self._aim.signs_of(rig)
        rig = with_delay(rig, s.delay_s)
        followed = s.observer.model_copy(update={"dx_m": s.dx_m})
        self._late_rig = rig
        planner = Planner(rig, self._aim, s)
        self._horizon = planner.horizon
        self.observer = Observer(rig, followed, self.taps)
        self._ahead = self._horizon.ahead_s
        count = int(np.ceil(self._ahead[-1] / PREVIEW_STEP_S - 1e-9)) + 1
        self.preview_s = tuple((PREVIEW_STEP_S * np.arange(count)).round(9).tolist())
        self.planning: Planning = Here(planner)
        self.took_s: deque[float] = deque(maxlen=KEPT)
        self.asked = self.missed = 0
        self.deferred = False
        self._in_force = InForce(s.null_v)
        self._begun = self._known = False
        self.reset()

    def plan_beside(self) -> None:
        """Has plans be made by a process beside, against the clock.

        Raises:
            InputError: It does not come up.
        """
        self.planning.end()
        self.planning = Beside(self._late_rig, self._aim, self.settings)

    def end(self) -> None:
        """Ends what makes plans."""
        self.planning.end()

    def check_rig(self, rig: Rig, who: str) -> None:
        """Refuses a rig that it does not plan on.

        Args:
            rig: The rig it shall run on.
            who: What to call it.

        Raises:
            InputError: It has other commands, taps or pipes.
        """
        check_same(rig_identity(self.rig), rig_identity(rig), OF_LINES, who, "plans on")

    def reset(self) -> None:
        """Forgets the past: state and rig are found anew from the first readings on."""
        self.pause()
        self._known = False

    def pause(self) -> None:
        """Lets the state go, as after a while without readings, but not what the rig is like.

        What was learnt of a model that is wrong goes too.
        """
        if self._begun:
            self._known = not self.observer.watch.wrong
        self._course = Course(0.0, np.full(self._horizon.knots, self.settings.null_v))
        self._next: Course | None = None
        self._time_s = 0.0
        self._asked_s = -math.inf
        self._now_v = self.settings.null_v
        self._begun = False
        self._heard: Heard | None = None
        self._in_force.reset()
        self.planning.forget()

    def applied(self, ago_s: float, volts: Mapping[str, float]) -> None:
        """Hears what a bridge says was applied; it need not be what was commanded.

        Args:
            ago_s: How long before the readings of the last step, s; below 0 after them.
            volts: By command, V; where one is missing nothing is made of it.
        """
        one = self._horizon.voltage_of(volts)
        if one is not None and self._begun:
            # what is applied acts at once, what is told after the delay that the model has
            self._in_force.apply(self._time_s - ago_s - self.settings.delay_s, one)

    def step(
        self,
        taps_pa: Mapping[str, float],
        targets_pa: Sequence[float],
        since_s: float | None = None,
        late_s: float = 0.0,
    ) -> float:
        """Voltage for the next period, decided before; see `Controller.step`.

        Args:
            taps_pa: Per sensor its newest reading, Pa, rad or m; one that is not finite is not
                there.
            targets_pa: Target at the times ahead, likewise.
            since_s: Time since the readings of the last step, s; None is a period.
            late_s: How old the readings are, s: so much later than they commands begin to act.

        Raises:
            ValueError: A target is not finite.
        """
        if not np.isfinite(targets_pa).all():
            raise ValueError("found a target that is not finite")
        if since_s is not None and not 0.0 < since_s <= LONGEST_S and self._begun:
            self.pause()
        self.follow()
        since = self.period_s if since_s is None else since_s
        if self._begun:
            self._time_s += since
        self._take()
        self._heard = Heard(dict(taps_pa), tuple(targets_pa), self._time_s, since, late_s)
        self._now_v = self._volts(self._time_s)
        self._in_force.tell(self._time_s + late_s, self._now_v)
        if not self.deferred:
            self.follow()
        return self._now_v

    def follow(self) -> None:
        """Does what is left of the last step: leads the observer on, has the next plan made."""
        if self._heard is None:
            return
        heard, self._heard = self._heard, None
        self._observe(heard)
        s = self.settings
        if self._time_s > self._asked_s + (s.every - EARLY) * s.period_s:
            self._ask(heard)

    def _volts(self, time_s: float) -> float:
        """What is commanded at a time, V: a plan goes by time, however late a step is."""
        s, course = self.settings, self._course
        if self._next is not None and time_s > self._next.begin_s - EARLY * s.period_s:
            course = self._next
        at = math.floor((time_s - course.begin_s) / s.period_s + EARLY)
        return float(self._horizon.every(course.volts)[min(max(at, 0), s.periods - 1)])

    def _ask(self, heard: Heard) -> None:
        """Has the next plan made: it begins when the time that it may take is over."""
        s = self.settings
        ahead = np.array([self._volts(self._time_s + n * s.period_s) for n in range(s.every)])
        begin_s = self._time_s + s.every * s.period_s
        middles = begin_s + self._horizon.middles_s
        request = Request(
            begin_s,
            np.array([self._volts(t) for t in middles]),
            ahead,
            np.interp(self._ahead, self.preview_s, heard.targets),
            self.observer.mean_state(),
            self.observer.drifts.lasting(),
            heard.late_s,
            self._in_force.at(heard.time_s),
        )
        self._asked_s = self._time_s
        self.asked += 1
        self.missed += not self.planning.ask(request)

    def _take(self) -> None:
        """Takes a plan that is ready; it goes on from where it then is."""
        if self._next is not None and self._time_s > self._next.begin_s - EARLY * self.period_s:
            self._course, self._next = self._next, None
        ready = self.planning.take()
        if ready is not None:
            self._next = Course(ready.begin_s, ready.volts)
            self.took_s.append(ready.took_s)

    def _observe(self, heard: Heard) -> None:
        """Leads the observer on, by what acted meanwhile."""
        end_s = heard.time_s
        if self._begun:
            samples = self.settings.samples
            step_s = heard.since_s / samples
            begin_s = end_s - heard.since_s
            held = [self._in_force.mean(begin_s + n * step_s, step_s) for n in range(samples)]
            self.observer.advance(self._horizon.each(np.array(held)), step_s)
        else:
            volts = self._horizon.each(np.array([self._in_force.at(end_s)]))[:, 0]
            told = dict(zip(self.observer.plant.plan.commands, volts.tolist(), strict=True))
            self.observer.begin(heard.readings, told, self._known)
            self._begun = True
        self.observer.assimilate(heard.readings)
        self._in_force.forget_before(end_s)
