# SPDX-License-Identifier: Apache-2.0
"""A recording laid out for comparison: the course that models follow, and its stretches."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.simulate import Course, Start
from pneu_sysid.records import Recording

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LONGEST_PULL = 3.0
"""A reading after a gap corrects the gas no more than one after this many of its periods."""

POSITION_PULL = float(np.sqrt(3.0 / np.sqrt(20.0)))
"""Time constant of the pull of a position, of that of the gas. Runs of the length T that begin at
the right place and speed are off by a T^2 / sqrt(20), root mean square, where a force makes the
acceleration wrong by a; a spring of the time constant t is off by a t^2. For the gas, whose flow is
wrong by a constant, the same makes t = T / sqrt(3)."""


def course_of(recording: Recording, sensors: list[str], pull_s: float | None) -> Course:
    """A recording as the sensors of a rig see it; how it begins is found later.

    A position is drawn to its encoder as by a spring and a damper of critical damping.

    Args:
        recording: The recording.
        sensors: Names of the taps, then of the encoders.
        pull_s: Time constant with which gas and joints are drawn to them, s; None lets them run
            free.
    """
    signals = [recording.readings.get(sensor) for sensor in sensors]
    most = max((len(s) for s in signals if s is not None), default=0)
    time = np.full((len(sensors), most), np.inf)
    measured = np.full((len(sensors), most), np.nan)
    gain, push = np.zeros((2, len(sensors), most))
    for t, signal in enumerate(signals):
        if signal is None or not len(signal):
            continue
        n = len(signal)
        time[t, :n], measured[t, :n] = signal.time_s, signal.values
        if pull_s is not None and n > 1:
            usual = signal.period_s
            since = np.minimum(
                np.diff(signal.time_s, prepend=signal.time_s[0] - usual), LONGEST_PULL * usual
            )
            if sensors[t] in recording.encoders:
                joint_s = pull_s * POSITION_PULL
                gain[t, :n] = 1.0 - np.exp(-2.0 * since / joint_s)
                push[t, :n] = since / joint_s**2
            else:
                gain[t, :n] = 1.0 - np.exp(-since / pull_s)
    nothing = Start(np.empty(0), np.empty(0))
    return Course(recording.commands, 0.0, recording.end_s, time, measured, gain, nothing, push)


def edges_of(recording: Recording, horizon_s: float | None, lead_s: float) -> Floats:
    """Where a recording is cut into stretches, s.

    Args:
        recording: The recording.
        horizon_s: Least length of a stretch, s; None is one stretch.
        lead_s: Time at the beginning that is not compared, s.

    Raises:
        InputError: It is shorter than that and one stretch.
    """
    first = recording.start_s + lead_s
    end = recording.end_s
    count = 1 if horizon_s is None else int((end - first) / horizon_s + 1e-6)
    if count < 1:
        raise InputError(
            f"recording {recording.name!r}: its {end - first + lead_s:.3g} s are fewer than"
            f" fit.warm_up_s and fit.horizon_s together ({lead_s + (horizon_s or 0.0):.3g} s)"
        )
    # The last reading belongs to the last stretch.
    return np.linspace(first, end + 1e-9, count + 1)


def index_of(course: Course, edges: Floats) -> Ints:
    """(n_stretches, horizon, n_taps) which reading of each tap stands where; -1 for none.

    Args:
        course: The recording.
        edges: (n_stretches + 1,) as of `edges_of`.
    """
    stretch = np.searchsorted(edges, course.time_s, side="right") - 1
    stretch[(course.time_s < edges[0]) | (course.time_s > edges[-1])] = -1
    count = edges.size - 1
    rows = []
    most = 1
    for t in range(stretch.shape[0]):
        inside = np.flatnonzero((stretch[t] >= 0) & (stretch[t] < count))
        of = stretch[t, inside]
        number = np.bincount(of, minlength=count)
        place = np.arange(inside.size) - np.repeat(np.cumsum(number) - number, number)
        rows.append((inside, of, place))
        most = max(most, int(number.max(initial=0)))
    out = np.full((count, most, stretch.shape[0]), -1, dtype=np.int64)
    for t, (inside, of, place) in enumerate(rows):
        out[of, place, t] = inside
    return out


def first_part(course: Course, end_s: float) -> Course:
    """The first part of a course.

    Args:
        course: The course.
        end_s: Where it ends, s.
    """
    if end_s >= course.end_s:
        return course
    count = int(np.max(np.sum(course.time_s <= end_s, axis=1), initial=0))
    part = slice(0, count)
    time = np.where(course.time_s[:, part] <= end_s, course.time_s[:, part], np.inf)
    measured = np.where(np.isfinite(time), course.measured[:, part], np.nan)
    push = None if course.push is None else course.push[:, part]
    return replace(
        course, end_s=end_s, time_s=time, measured=measured, gain=course.gain[:, part], push=push
    )
