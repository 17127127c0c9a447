# SPDX-License-Identifier: Apache-2.0
"""Who makes plans: the controller's own thread, or a process beside that uses another core."""

import contextlib
import functools
import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.garbage import spare_what_stays
from pneu_policy.control.horizon import Aim, Horizon
from pneu_policy.control.improve import improvement
from pneu_policy.control.predictive_settings import PredictiveSettings
from pneu_sim.plant import State
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

PLANS, PLANS_LATE = "plans", "plans late"
"""What /diagnostics calls how many were wanted, and how many of them were not made in time."""
READY_S = 120.0
"""How long a process beside may take to build its model; the first time it compiles it."""


@dataclass(frozen=True)
class Request:
    """What is to be planned.

    Attributes:
        begin_s: When the plan begins, s.
        plan: (knots,) what to begin from, V.
        decided: (every,) what is commanded until then, V.
        target: (samples,) Pa, rad or m.
        state: State now, of one rig.
        drifted: (unknowns,) by how much the rig is off its file.
        late_s: How much later than they are told commands reach the valve, s.
        before_v: What is in force until then, V.
    """

    begin_s: float
    plan: Floats
    decided: Floats
    target: Floats
    state: State
    drifted: Floats
    late_s: float = 0.0
    before_v: float = 0.0


@dataclass(frozen=True)
class Plan:
    """A plan that was made.

    Attributes:
        begin_s: When it begins, s.
        volts: (knots,) V.
        took_s: How long it took, s.
    """

    begin_s: float
    volts: Floats
    took_s: float


class Planning(Protocol):
    """Somebody who makes plans, one at a time."""

    def ask(self, request: Request) -> bool:
        """Hands a request over.

        Args:
            request: The request.

        Returns:
            False while another one is still being planned; then nothing is handed over.
        """

    def take(self) -> Plan | None:
        """Returns the plan that was asked for last, once it is ready and was not taken yet."""

    def forget(self) -> None:
        """Lets go of what was asked for."""

    def end(self) -> None:
        """Ends whatever was begun."""


class Planner:
    """Makes plans."""

    def __init__(self, rig: Rig, aim: Aim, settings: PredictiveSettings) -> None:
        """Builds the model.

        Args:
            rig: The rig.
            aim: What is controlled, by what.
            settings: How plans are made.

        Raises:
            InputError: The rig cannot be planned on.
        """
        self._s = settings
        self._improve = improvement(settings)
        self.horizon = Horizon(rig, aim, settings, self._improve.lanes)

    def plan(self, request: Request, elapsed_s: Callable[[], float] | None = None) -> Plan:
        """Makes a plan.

        Args:
            request: What is asked for.
            elapsed_s: Time since the request, s, by which improving ends; None improves as often
                as the settings say, whatever time that takes.
        """
        s, begin = self._s, time.perf_counter()
        self.horizon.begin(request.state, request.drifted)
        self.horizon.late(request.late_s, request.before_v)
        volts = request.plan
        for _ in range(s.rounds):
            volts = self._improve.better(self.horizon, volts, request.target, request.decided)
            if elapsed_s is not None and elapsed_s() > s.share * s.period_s * s.every:
                break
        return Plan(request.begin_s, volts, time.perf_counter() - begin)

    def warm(self) -> None:
        """Makes a plan that nobody asked for: the first of a process loads what it runs."""
        s, knots = self._s, self.horizon.knots
        state, drifted = self.horizon.at_rest()
        target = np.full(self.horizon.ahead_s.size, 2e5 if s.scale > 1.0 else 0.0)
        plan, decided = np.full(knots, s.null_v), np.full(s.every, s.null_v)
        self.plan(Request(0.0, plan, decided, target, state, drifted))
        self.forget()

    def forget(self) -> None:
        """Forgets what it has learnt."""
        self._improve.reset()


class Here:
    """Plans in the controller's own thread, when they are taken: the same on any machine."""

    def __init__(self, planner: Planner) -> None:
        """Has nothing to plan.

        Args:
            planner: Who plans.
        """
        self._planner = planner
        self._request: Request | None = None

    def ask(self, request: Request) -> bool:
        """Keeps a request; see `Planning.ask`.

        Args:
            request: The request.
        """
        self._request = request
        return True

    def take(self) -> Plan | None:
        """Plans what was asked for; see `Planning.take`."""
        request, self._request = self._request, None
        return None if request is None else self._planner.plan(request)

    def forget(self) -> None:
        """Lets go of what was asked for."""
        self._request = None
        self._planner.forget()

    def end(self) -> None:
        """There is nothing to end."""


class Beside:
    """Plans in a process of its own, against the clock."""

    def __init__(self, rig: Rig, aim: Aim, settings: PredictiveSettings) -> None:
        """Starts the process, and waits until it has its model.

        Args:
            rig: The rig.
            aim: What is controlled, by what.
            settings: How plans are made.

        Raises:
            InputError: It does not come up.
        """
        context = multiprocessing.get_context("spawn")
        self._mine, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, rig, aim, settings), daemon=True
        )
        self._process.start()
        theirs.close()
        self._busy = False
        self._stale = False
        self._plan: Plan | None = None
        if not self._mine.poll(READY_S) or self._hear() is not None:
            self.end()
            raise InputError("the process that makes plans did not come up")

    def _hear(self) -> Plan | None:
        """What the process says; raises where it has ended."""
        try:
            said: Plan | None = self._mine.recv()
        except (EOFError, OSError) as error:
            raise InputError("the process that makes plans has ended") from error
        return said

    def ask(self, request: Request) -> bool:
        """Sends a request; see `Planning.ask`.

        Args:
            request: The request.
        """
        self._look()
        if self._busy:
            return False
        try:
            self._mine.send(request)
        except OSError as error:
            raise InputError("the process that makes plans has ended") from error
        self._busy = True
        return True

    def take(self) -> Plan | None:
        """Takes what is ready; see `Planning.take`."""
        self._look()
        plan, self._plan = self._plan, None
        return plan

    def _look(self) -> None:
        """Hears whether the plan that was asked for is there."""
        if not (self._busy and self._mine.poll()):
            return
        plan, self._busy = self._hear(), False
        stale, self._stale = self._stale, False
        self._plan = None if stale else plan

    def forget(self) -> None:
        """Has the plan that is being made come to nothing."""
        self._stale = self._busy
        self._plan = None

    def end(self) -> None:
        """Ends the process."""
        self._mine.close()
        self._process.join(1.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def _since(begin_s: float) -> float:
    """Time since a time of the steady clock, s."""
    return time.monotonic() - begin_s


def _serve(pipe: Connection, rig: Rig, aim: Aim, settings: PredictiveSettings) -> None:
    """What the process does: plans until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # its controller ends it
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, os.getpriority(os.PRIO_PROCESS, os.getppid()))
    planner = Planner(rig, aim, settings)
    planner.warm()
    spare_what_stays()
    pipe.send(None)
    while True:
        try:
            request = pipe.recv()
        except (EOFError, OSError):
            return
        begin = time.monotonic()
        plan = planner.plan(request, functools.partial(_since, begin))
        with contextlib.suppress(OSError):
            pipe.send(plan)
