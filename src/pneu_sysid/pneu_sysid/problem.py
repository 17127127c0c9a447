# SPDX-License-Identifier: Apache-2.0
"""A recording and a rig as one estimation problem: roll-outs, residuals, what is held out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from pneu_sim import lumped
from pneu_sim.errors import InputError
from pneu_sim.rig.build import Model, Plan, build, plan_grid
from pneu_sim.rig.schema import Rig
from pneu_sim.simulate import InitialField, Rollouts, initial_field, rollouts
from pneu_sysid.records import Recording, noise_floor_pa, read_recording

Floats = NDArray[np.float64]

HELD_OUT_EVERY = 3
"""Every third roll-out is kept aside."""


@dataclass
class Problem:
    """Everything about a recording that does not change with the parameters.

    Attributes:
        recording: The recording.
        taps: Names of the taps that are compared.
        measured: (T, n_taps) readings, Pa; NaN where missing.
        smooth: (T, n_taps) smoothed readings that start and warm up the roll-outs.
        noise_pa: (n_taps,) sensor noise floor.
        starts: First sample of each roll-out, warm-up included.
        warm_up: Samples of warm-up.
        horizon: Samples compared per roll-out.
        nudge_s: Time constant of the pull to the taps during the warm-up.
        dx_m: Cell length; None is the rig's own.
        workers: Threads of a batch; None is one per core.
    """

    recording: Recording
    taps: list[str]
    measured: Floats
    smooth: Floats
    noise_pa: Floats
    starts: list[int]
    warm_up: int
    horizon: int
    nudge_s: float
    dx_m: float | None = None
    workers: int | None = None
    _plans: dict[str, tuple[Plan, InitialField]] = field(default_factory=dict, repr=False)

    @property
    def dt_s(self) -> float:
        """Sample interval, s."""
        return 1.0 / self.recording.rate_hz

    @property
    def held_out(self) -> NDArray[np.bool_]:
        """(n_starts,) which roll-outs are kept aside."""
        k = np.arange(len(self.starts))
        return k % HELD_OUT_EVERY == HELD_OUT_EVERY - 1

    def windows(self) -> NDArray[np.int64]:
        """(n_starts, horizon) sample numbers that each roll-out is compared at."""
        first = np.array(self.starts)[:, None] + self.warm_up
        return first + np.arange(self.horizon)

    def target(self) -> Floats:
        """(n_starts, horizon, n_taps) measured readings of the roll-outs."""
        return self.measured[self.windows()]

    def simulate(
        self,
        rigs: Sequence[Rig],
        starts: Sequence[int] | None = None,
        progress: Callable[[float], None] | None = None,
        strict: bool = True,
    ) -> Rollouts:
        """Rolls rigs out along the recording, in one batch.

        Args:
            rigs: Rigs of one structure and one ``model``.
            starts: Roll-outs to run; None is all.
            progress: Called with the fraction done.
            strict: Whether an unstable simulation is an error; else its predictions are not finite.

        Returns:
            Predictions without the warm-up: (n_rigs, n_starts, horizon, ...).
        """
        plan, initial = self._plan(rigs[0])
        if rigs[0].model == "pde":
            run = partial(rollouts, self._models(rigs, plan), strict=strict)
        else:
            run = partial(lumped.rollouts, [lumped.build(rig, plan) for rig in rigs])
        out = run(
            initial,
            self.recording.commands,
            self.dt_s,
            self.starts if starts is None else starts,
            self.warm_up + self.horizon,
            self.smooth,
            warm_up=self.warm_up,
            nudge_s=self.nudge_s,
            workers=self.workers,
            progress=progress,
        )
        w = self.warm_up
        return Rollouts(out.readings[:, :, w:], out.flows[:, :, w:], out.chambers[:, :, w:])

    def predict(
        self, rigs: Sequence[Rig], progress: Callable[[float], None] | None = None
    ) -> Floats:
        """(n_rigs, n_starts, horizon, n_taps) predicted readings, Pa.

        Args:
            rigs: Rigs of one structure.
            progress: Called with the fraction done.
        """
        return self.simulate(rigs, progress=progress).readings

    def residual(self, readings: Floats) -> Floats:
        """Measured minus predicted, in units of each tap's noise; 0 where nothing was measured.

        Args:
            readings: (..., n_starts, horizon, n_taps) predictions.
        """
        return np.nan_to_num((self.target() - readings) / self.noise_pa, nan=0.0)

    def every(self, k: int) -> "Problem":
        """The same problem with every k-th roll-out only.

        Args:
            k: Stride.
        """
        from dataclasses import replace

        return replace(self, starts=self.starts[::k])

    def with_grid(self, dx_m: float) -> "Problem":
        """The same problem on another grid.

        Args:
            dx_m: Cell length that replaces the rig's.
        """
        from dataclasses import replace

        return replace(self, dx_m=dx_m, _plans={})

    def _plan(self, rig: Rig) -> tuple[Plan, InitialField]:
        key = ",".join(f"{n}:{p.from_node}:{p.to_node}" for n, p in rig.pipes.items())
        if key not in self._plans:
            plan = plan_grid(rig, self.dx_m)
            self._plans[key] = (plan, initial_field(rig, plan))
        return self._plans[key]

    @staticmethod
    def _models(rigs: Sequence[Rig], plan: Plan) -> list[Model]:
        return [build(rig, plan) for rig in rigs]


def record_for(
    rig: Rig, path: str, start_s: float | None = None, end_s: float | None = None
) -> Recording:
    """Reads the recording of a rig: its commands and tap pressures.

    Args:
        path: Bag or text file.
        rig: Rig whose channels say where the signals are.
        start_s: Start of the part to keep, in s after the start of the recording.
        end_s: End of the part to keep, in s after the start of the recording.

    Raises:
        InputError: The recording cannot be read as the rig describes.
    """
    commands = {n: c.channel for n, c in rig.commands.items() if c.channel is not None}
    missing = set(rig.commands) - set(commands)
    if missing:
        raise InputError(f"rig {rig.name!r}: commands.{sorted(missing)[0]} has no channel to read")
    pressures = {n: t.channel for n, t in rig.taps.items() if t.channel is not None}
    if not pressures:
        raise InputError(f"rig {rig.name!r}: no tap has a channel, so nothing can be compared")
    return read_recording(
        path,
        commands=commands,
        pressures=pressures,
        text=rig.text,
        rate_hz=rig.rate_hz,
        start_s=start_s,
        end_s=end_s,
    )


def _smooth(series: Floats) -> Floats:
    """Local quadratic over nine samples; gaps stay gaps."""
    if series.shape[0] < 9:
        return series
    good = np.isfinite(series)
    out = np.full_like(series, np.nan)
    for t in range(series.shape[1]):
        if good[:, t].all():
            out[:, t] = savgol_filter(series[:, t], 9, 2)
        else:
            out[:, t] = series[:, t]
    return out


def make_problem(
    rig: Rig,
    recording: Recording,
    horizon_s: float | None = None,
    dx_m: float | None = None,
    workers: int | None = None,
) -> Problem:
    """Cuts a recording into roll-outs for a rig (thesis 8.1.2).

    Args:
        rig: The rig; its ``fit`` section sets horizon and warm-up.
        recording: The recording.
        horizon_s: Replaces the rig's horizon.
        dx_m: Replaces the rig's cell length.
        workers: Threads of a batch.

    Raises:
        InputError: The recording is shorter than one roll-out.
    """
    taps = list(rig.taps)
    n = recording.time_s.size
    measured = np.full((n, len(taps)), np.nan)
    for t, name in enumerate(taps):
        if name in recording.pressures:
            measured[:, t] = recording.pressures[name]
    rate = recording.rate_hz
    noise = np.array(
        [
            noise_floor_pa(measured[:, t]) if np.isfinite(measured[:, t]).any() else 1.0
            for t in range(len(taps))
        ]
    )
    # A silent sensor (simulated, or coarser than its noise) still cannot resolve below this.
    scale = np.nanmax(np.abs(measured)) if np.isfinite(measured).any() else 1.0
    noise = np.maximum(np.nan_to_num(noise, nan=0.0), 1e-6 * scale)
    warm_up = round(rig.fit.warm_up_s * rate)
    horizon = horizon_s or rig.fit.horizon_s
    if horizon is None:
        warm_up = 0
        length = n
        starts = [0]
    else:
        length = max(2, round(horizon * rate))
        starts = list(range(0, n - warm_up - length + 1, length))
    if not starts:
        raise InputError(
            f"recording {recording.name!r}: {n} samples ({n / rate:.3g} s) are fewer than one"
            f" roll-out of {warm_up + length} samples ({(warm_up + length) / rate:.3g} s)"
        )
    return Problem(
        recording=recording,
        taps=taps,
        measured=measured,
        smooth=_smooth(measured),
        noise_pa=noise,
        starts=starts,
        warm_up=warm_up,
        horizon=length,
        nudge_s=rig.fit.nudge_s,
        dx_m=dx_m,
        workers=workers,
    )
