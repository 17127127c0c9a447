# SPDX-License-Identifier: Apache-2.0
"""State and contact force as readings come in: the estimate of trajectories on a moving window.

It is the estimator of recordings (thesis 2.3) on the last knots alone, which the thesis names as
future work (2.8): residuals, norms and slopes are the same. New knots begin where the model rolls
on from those before; a step or two of Gauss and Newton moves the window; the oldest two knots are
held at what they were estimated to be, and carry what came before. What is told lags behind the
newest reading by a few knots, since an acceleration needs the knot after it, and a force is as
sure as the readings on either side.
"""

from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpbtrs

from pneu_common.errors import InputError
from pneu_sim.hand.touch import geoms_with, touch_of
from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.arrow import band_of
from pneu_sysid.contacts.chain import Chain, Outputs, with_slack
from pneu_sysid.contacts.drawn import settled
from pneu_sysid.contacts.knots import chain_of, channel_of, control_of
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value
from pneu_sysid.contacts.track import Series, Track

Floats = NDArray[np.float64]

HELD = 2
"""Knots at the beginning of the window that stay where they are."""
FIRM = 1e8
"""How much more firmly they are held than anything else."""
SLOW = 1.5
"""Knots between readings of a sensor that is not waited for."""
LEAST = 8
"""Readings of each sensor that are remembered, however old."""
KEPT = 4
"""Knots before the window whose readings are remembered."""
ROOM = 4096
"""Readings of a sensor, at most."""
GAP = 120
"""Knots after which the window begins anew; a shorter gap is filled."""
AGAIN = 3
"""Steps after a gap."""
SETTLING = 6
"""Steps of the first window."""
TROUBLED = 4.0
"""Times the usual cost of a window, above which it is estimated further."""
MENDING = 6
"""Steps of that, at most."""
TRIES = 3
"""Halvings of a step that makes nothing better."""


@dataclass(frozen=True)
class Estimate:
    """What is known of one instant.

    Attributes:
        time_s: When.
        q: (nq,) configuration.
        v: (nv,) velocities.
        touch: (6,) force on others, and its moment about the origin, of the tree of bodies that was
            asked for.
        lag_s: By how much it is older than the newest reading that was used.
    """

    time_s: float
    q: Floats
    v: Floats
    touch: Floats
    lag_s: float


class _Readings:
    """The last readings of a sensor or an actuator, in arrays that are moved up when full."""

    def __init__(self, width: int) -> None:
        self._turns = width == 4
        self._time = np.empty(ROOM)
        self._values = np.empty((ROOM, width))
        self._first = self._end = 0

    def add(self, time_s: float, values: Floats) -> None:
        if self._end > self._first and time_s <= self._time[self._end - 1]:
            return  # it came late, or twice
        if self._turns:
            values = values / np.linalg.norm(values)
            if self._end > self._first and float(values @ self._values[self._end - 1]) < 0.0:
                values = -values
        if self._end == ROOM:
            kept = min(self._end - self._first, ROOM // 2)
            self._time[:kept] = self._time[self._end - kept : self._end]
            self._values[:kept] = self._values[self._end - kept : self._end]
            self._first, self._end = 0, kept
        self._time[self._end], self._values[self._end] = time_s, values
        self._end += 1

    def forget(self, before_s: float) -> None:
        at = self._first + int(np.searchsorted(self._time[self._first : self._end], before_s))
        self._first = max(self._first, min(at, self._end - LEAST))

    @property
    def oldest_s(self) -> float:
        return float(self._time[self._first])

    @property
    def newest_s(self) -> float:
        return float(self._time[self._end - 1]) if self._end > self._first else -np.inf

    @property
    def every_s(self) -> float:
        """Mean time between readings, s."""
        count = len(self) - 1
        return (self.newest_s - self.oldest_s) / count if count > 0 else np.inf

    def series(self) -> Series:
        at = slice(self._first, self._end)
        return Series(self._time[at].copy(), self._values[at].copy())

    def __len__(self) -> int:
        return self._end - self._first


class Window:
    """The estimator.

    Attributes:
        loaded: The scene.
        step_s: Time between knots.
        cost: Of the window, after the last step.
        restarts: How often it began anew, as after a gap.
    """

    def __init__(
        self,
        loaded: Loaded,
        values: tuple[Value, ...],
        body: str,
        step_s: float = 0.0025,
        knots: int = 16,
        iterations: int = 1,
        lag_knots: int = 2,
        physics: Physics | None = None,
    ) -> None:
        """Knows nothing yet.

        Args:
            loaded: The scene.
            values: Its effects, as they were identified.
            body: A body of the tree whose force on others is told.
            step_s: Time between knots.
            knots: Of the window.
            iterations: Steps of Gauss and Newton for each advance.
            lag_knots: How many knots what is told is behind the last that has an acceleration.
            physics: What evaluates models; one thread unless given.
        """
        self.loaded, self.step_s = loaded, step_s
        self._knots, self._iterations, self._lag = knots, iterations, lag_knots
        self._physics = physics or Physics(1)
        self._setup = loaded.setup(values)
        self._model: Any = self._setup.spec.compile()
        self._mujoco = mujoco_module()
        self._data: Any = self._mujoco.MjData(self._model)
        self._own = geoms_with(self._model, self._model.body(body).id)
        self._sensors = {name: _Readings(loaded.widths[name]) for name in loaded.names}
        self._controls = {name: _Readings(1) for name in loaded.scene.controls}
        self._all = [*self._sensors.values(), *self._controls.values()]
        self._chain: Chain | None = None
        self._q = np.zeros((0, self._model.nq))
        self.cost = 0.0
        self.restarts = 0
        self._costs: deque[float] = deque(maxlen=200)

    def sensor(self, name: str, time_s: float, values: Floats) -> None:
        """Takes a reading.

        Args:
            name: Sensor of the MJCF.
            time_s: When.
            values: (w,) in SI units, quaternions scalar first.
        """
        self._sensors[name].add(time_s, np.asarray(values, dtype=float))

    def control(self, name: str, time_s: float, value: float) -> None:
        """Takes what an actuator was told.

        Args:
            name: Actuator of the MJCF.
            time_s: When.
            value: What.
        """
        self._controls[name].add(time_s, np.array([value]))

    @property
    def newest_s(self) -> float:
        """Until when all have told that are not much slower than knots."""
        quick = [r.newest_s for r in self._all if r.every_s < SLOW * self.step_s]
        return min(quick or [r.newest_s for r in self._all])

    def advance(self) -> Estimate | None:
        """Moves the window to the newest readings.

        Returns:
            What is known now; None where nothing new can be.
        """
        if any(len(r) < LEAST for r in self._all):
            return None
        newest = self.newest_s
        if self._chain is None or newest - self._chain.time_s[-1] > GAP * self.step_s:
            if not self._begin(newest):
                return None
        else:
            fresh = int((newest - self._chain.time_s[-1] - 0.5 * self.step_s) / self.step_s)
            if fresh < 1:
                return None
            self._extend(fresh)
            # after a gap more knots are new than were estimated: they need more than one step
            self._step(self._iterations if fresh < self._knots // 2 else AGAIN)
            self._mend()
        for readings in self._all:
            readings.forget(newest - (self._knots + KEPT) * self.step_s)
        return self._told(newest)

    def _track(self) -> Track:
        return Track(
            "window",
            {name: r.series() for name, r in self._sensors.items()},
            {name: r.series() for name, r in self._controls.items()},
        )

    def _begin(self, newest: float) -> bool:
        """Lays the first window, where there are readings for it."""
        span = self._knots * self.step_s
        oldest = max(r.oldest_s for r in self._all)
        if newest - oldest < span + self.step_s:
            return False
        begin = newest - 0.5 * self.step_s - span
        track = self._track()
        track = track.between(begin - 1e-6, newest, "window")
        if any(len(s.time_s) < 4 for s in track.sensors.values()):
            return False
        try:
            chain = chain_of(self.loaded, track, self._model, self.step_s)
        except InputError:  # readings of some sensor are missing within it
            return False
        chain, q = settled(chain, self._model, self._setup)
        if not np.isfinite(q).all():
            q = chain.start
        self.restarts += self._chain is not None
        self._chain, self._q = chain, q
        self._slack()
        self._step(SETTLING, held=0)
        return True

    def _extend(self, fresh: int) -> None:
        """Adds knots where the model rolls on to, and drops as many of the oldest."""
        assert self._chain is not None
        chain, h = self._chain, self.step_s
        t = np.concatenate([chain.time_s, chain.time_s[-1] + h * np.arange(1, fresh + 1)])
        track = self._track()
        control = control_of(track, self._model, t)
        q = list(self._q)
        last = t[len(q) - 1] - t[len(q) - 2]
        v = chain.manifold.between(q[-2][None], q[-1][None])[0] / last
        data = self._data
        for k in range(len(q) - 1, len(t) - 1):
            data.qpos[:], data.qvel[:] = q[-1], v
            if self._model.nu:
                data.ctrl[:] = control[k]
            self._mujoco.mj_forward(self._model, data)
            v = v + h * data.qacc
            at = q[-1].copy()
            self._mujoco.mj_integratePos(self._model, at, v, h)
            q.append(at)
        drop = max(0, len(t) - max(self._knots + 1, fresh + 2 * HELD))
        t, self._q, control = t[drop:], np.array(q[drop:]), control[drop:]
        self._chain = replace(
            chain,
            time_s=t,
            channels=tuple(
                channel_of(self.loaded, track, self._model, t, c.name) for c in chain.channels
            ),
            control=control,
            start=self._q,
            slack=np.ones((len(t), chain.manifold.nv)),
            near=np.ones(len(t), dtype=bool),
            taken=None,
        )
        self._take()
        self._slack()

    def _take(self) -> None:
        """Takes the readings at all knots, once for all that is computed of them."""
        assert self._chain is not None
        chain, told = self._chain, self._setup.readings
        taken = {c.name: chain.measured(c, told[c.name]) for c in chain.channels}
        self._chain = replace(chain, taken=taken)

    def _slack(self) -> None:
        assert self._chain is not None
        self._chain = with_slack(
            self._chain, self.loaded, self._q, self._model, self._setup, self._physics
        )

    def _outputs(self, q: Floats) -> Outputs:
        assert self._chain is not None
        return self._chain.outputs(q, self._model, self._setup, self._physics)

    def _step(self, iterations: int, held: int = HELD) -> None:
        """Steps of Gauss and Newton, the oldest knots held."""
        assert self._chain is not None
        chain = self._chain
        nv = chain.manifold.nv
        outputs = self._outputs(self._q)
        for _ in range(iterations):
            arrow = chain.arrow(
                self._q, outputs, self._model, self._setup, [], self._physics, centred=False
            )
            self.cost = arrow.cost
            band = band_of(arrow, 1e-6)
            if held:
                band[0, : held * nv] += FIRM * band[0].max()
            factor, failed = dpbtrf(band, lower=1, overwrite_ab=1)
            if failed:
                return
            step, failed = dpbtrs(factor, -arrow.slope.reshape(-1, 1), lower=1)
            if failed or not np.isfinite(step).all():
                return
            step = step.reshape(-1, nv)
            for halving in range(TRIES + 1):
                tried = chain.manifold.moved(self._q, 0.5**halving * step)
                there = self._outputs(tried)
                cost = chain.cost(there, self._setup)
                if cost < self.cost:
                    self._q, outputs, self.cost = tried, there, cost
                    break
            else:
                return

    def _mend(self) -> None:
        """Goes on while far more is left than usual, as where an impact went another way."""
        usual = float(np.median(self._costs)) if self._costs else np.inf
        for _ in range(MENDING):
            before = self.cost
            if self.cost <= TROUBLED * usual:
                break
            self._step(1)
            if self.cost > 0.99 * before:
                break
        self._costs.append(self.cost)

    def _told(self, newest: float) -> Estimate:
        assert self._chain is not None
        motion = self._chain.motion(self._q, self._setup)
        at = max(len(self._q) - 2 - self._lag, 1)
        data = self._data
        data.qpos[:], data.qvel[:], data.qacc[:] = motion.q[at], motion.v[at], motion.a[at]
        self._mujoco.mj_inverse(self._model, data)
        time_s = float(self._chain.time_s[at])
        return Estimate(
            time_s,
            motion.q[at].copy(),
            motion.v[at].copy(),
            touch_of(self._model, data, self._own),
            newest - time_s,
        )
