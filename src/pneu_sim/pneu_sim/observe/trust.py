# SPDX-License-Identifier: Apache-2.0
"""Which sensors are believed, and what is the matter with those that are not.

A reading far beyond what was foreseen counts less (Huber 1964): as if its noise had been such that
it is just within the gate, or not at all where all others are within. One that stays beyond while
the others agree with the model is out: its sensor is wrong, and the rest goes on without it until
it agrees again. Where most readings are beyond at once it is the model that is wrong, and all are
taken in full.

Taps are judged by taps, and encoders by encoders: what gas does says little of a link that carries
what no rig file tells, and an encoder that nobody else can speak for is taken in full.
"""

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pneu_sim.observe.settings import ObserverSettings

Floats = NDArray[np.float64]

STILL = 0.3
"""A sensor that varies by less than this share of its noise is frozen, where the gas moves."""
FARTHER = 0.3
"""A sensor whose innovations are so much larger than the others' is the one that is wrong."""
EXPLAINS = 0.7
"""Share of the differences that a bias or a lag has to explain to be named."""
SMOOTH = 5
WINDOW = np.full(SMOOTH, 1.0 / SMOOTH)
"""Readings are smoothed over so many before they are differentiated."""
FEWEST = 20
"""Readings from which on something is named."""
FEWEST_ENCODERS = 3
"""Of fewer nobody can tell which is wrong, and what they move may be: all are taken in full."""


@dataclass
class Standing:
    """How a sensor stands.

    Attributes:
        out: Whether it is left out.
        beyond: Readings in a row beyond the gate.
        within: Readings in a row within it, while it is out.
        rms: Recent root mean square of its innovations, in standard deviations.
        seen: Recent (time s, reading, foreseen) of it while it was beyond or out.
    """

    out: bool = False
    beyond: int = 0
    within: int = 0
    rms: float = 1.0
    seen: deque[tuple[float, float, float]] = field(default_factory=lambda: deque(maxlen=400))


class Trust:
    """Which of the sensors are believed.

    Attributes:
        standing: By sensor how it stands.
    """

    def __init__(
        self,
        sensors: Sequence[str],
        noise: Mapping[str, float],
        settings: ObserverSettings,
        encoders: Collection[str] = (),
    ) -> None:
        """Believes all.

        Args:
            sensors: Those whose readings are taken.
            noise: Of each, one sigma.
            settings: Gates.
            encoders: Those that are no taps.
        """
        self._s, self._noise = settings, dict(noise)
        self._encoders = set(encoders) & set(sensors)
        self.standing = {name: Standing() for name in sensors}

    def reset(self) -> None:
        """Believes all again."""
        self.standing = {name: Standing() for name in self.standing}

    def weigh(
        self,
        time_s: float,
        interval_s: float,
        readings: Mapping[str, float],
        foreseen: Mapping[str, float],
        total: Mapping[str, float],
    ) -> dict[str, float]:
        """By how much the variance of each reading's noise is multiplied; infinite leaves it out.

        Args:
            time_s: Present time, s.
            interval_s: Since the last readings, s.
            readings: By sensor.
            foreseen: Likewise, before any is taken.
            total: Variance of the difference, likewise.
        """
        z = {n: (readings[n] - foreseen[n]) / math.sqrt(total[n]) for n in readings}
        for name, value in z.items():
            at = self.standing[name]
            if abs(value) > self._s.gate or at.out:
                at.seen.append((time_s, readings[name], foreseen[name]))
        taps = {n: value for n, value in z.items() if n not in self._encoders}
        encoders = {n: value for n, value in z.items() if n in self._encoders}
        told = self._judged(taps, time_s, interval_s)
        if len(self._encoders) < FEWEST_ENCODERS:
            return told | dict.fromkeys(encoders, 1.0)
        return told | self._judged(encoders, time_s, interval_s)

    def _judged(self, z: Mapping[str, float], time_s: float, interval_s: float) -> dict[str, float]:
        """The same of sensors of one kind, by their innovations in standard deviations."""
        s = self._s
        far = {n for n, value in z.items() if abs(value) > s.gate}
        keep = math.exp(-interval_s / s.patience_s)
        believed = [n for n in z if not self.standing[n].out]
        # of one or two nobody can tell which is wrong
        most_far = len(believed) > 2 and len(far & set(believed)) * 2 > len(believed)
        out: dict[str, float] = {}
        for name, value in z.items():
            at = self.standing[name]
            at.rms = math.sqrt(keep * at.rms**2 + (1.0 - keep) * min(value * value, 1e4))
            at.beyond = at.beyond + 1 if name in far else 0
            at.within = at.within + 1 if at.out and name not in far else 0
            others = [self.standing[n].rms for n in believed if n != name]
            # one that is wrong draws the others along, if less
            agree = bool(others) and max(others) <= max(s.agreeing, FARTHER * at.rms)
            if at.out and at.within * interval_s >= s.return_s:
                at.out, at.within = False, 0
                at.seen.clear()
            settled = time_s >= s.settle_s
            if not at.out and settled and at.beyond * interval_s >= s.patience_s and agree:
                at.out = True
            sure = settled and not most_far
            alone = name in far and not (far & set(believed)) - {name} and len(believed) > 2
            if at.out or (sure and (alone or (agree and abs(value) > s.hard_gate))):
                out[name] = math.inf
            else:
                # counted less, many that are right would lose to one that is wrong and near
                out[name] = 1.0 if most_far else max(1.0, (value / s.gate) ** 2)
        return out

    def matter(self, name: str) -> str:
        """What is the matter with a sensor that is out; nothing if it is believed.

        Args:
            name: The sensor.
        """
        at = self.standing[name]
        if not at.out:
            return ""
        if len(at.seen) < FEWEST:
            return "disagrees with the model and the other sensors"
        time_s, reading, foreseen = np.array(at.seen).T
        noise = self._noise[name]
        if reading.std() < STILL * noise and foreseen.std() > 2.0 * noise:
            return "frozen"
        off = reading - foreseen
        # of a first-order lag: what it shows changes by what it is off, over the lag
        smooth = np.convolve(np.pad(reading, SMOOTH // 2, mode="edge"), WINDOW, mode="valid")
        rate = np.gradient(smooth, time_s)
        whole = float(off @ off)
        bias = float(off.mean())
        lag = -float(off @ rate) / max(float(rate @ rate), 1e-30)
        by_bias = 1.0 - float(((off - bias) ** 2).sum()) / whole
        by_lag = 1.0 - float(((off + lag * rate) ** 2).sum()) / whole
        if max(by_bias, by_lag) < EXPLAINS:
            return "disagrees with the model and the other sensors"
        if by_lag > by_bias and lag > 0.0:
            return f"late by {1e3 * lag:.3g} ms"
        return f"off by {bias:.3g}"
