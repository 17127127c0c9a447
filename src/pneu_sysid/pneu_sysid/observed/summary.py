# SPDX-License-Identifier: Apache-2.0
"""What an observer said along a recording, in figures: errors, how far to trust them, and words."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from pneu_common.installed import version
from pneu_sim.rig.schema import Rig
from pneu_sysid.observed.follow import Followed
from pneu_sysid.results.observe import Drifting, ObservedSensor, ObserveResult, Said
from pneu_sysid.sensor_units import encoder_units

BEGIN_S = 1.0
"""Errors count from here on: before, the beginning is forgotten ..."""
SHORT = 0.2
"""... or from this part of a recording on, where that is less."""
NINETY = 1.645
"""Half width of a 90 % interval, in standard deviations."""
APART_S = 0.1
"""What is said again within this time was never taken back."""


def begin_of(found: Followed) -> float:
    """From when on errors count, s.

    Args:
        found: What an observer said.
    """
    return min(BEGIN_S, SHORT * float(found.time_s[-1]))


def summary_of(
    rig: Rig,
    rig_file: str,
    name: str,
    found: Followed,
    used: Sequence[str],
    noise: Mapping[str, float],
    findings: Sequence[str] = (),
    smooth_s: float = 0.0,
) -> ObserveResult:
    """The result of `pneu observe`.

    Args:
        rig: The rig.
        rig_file: Its file.
        name: Of the recording.
        found: What an observer said.
        used: Sensors whose readings it took.
        noise: By sensor, Pa, rad or m.
        findings: What was wrong with the recording.
        smooth_s: So much later readings counted too, s.
    """
    begin_s = begin_of(found)
    sensors = []
    for sensor in found.mean:
        error = found.error(sensor, begin_s) if sensor in found.read else np.zeros(0)
        there = error.size > 0
        rmse = float(np.sqrt(np.mean(error**2))) if there else None
        late = found.time_s >= begin_s
        sensors.append(
            ObservedSensor(
                name=sensor,
                used=sensor in used,
                rmse=rmse,
                times_noise=None if rmse is None else rmse / noise[sensor],
                within_90=found.covered(sensor, noise[sensor], NINETY, begin_s, np.inf)
                if there
                else None,
                std=float(np.sqrt(np.mean(found.std[sensor][late] ** 2))),
            )
        )
    units = encoder_units(rig)
    return ObserveResult(
        pneu_version=version(),
        recording=name,
        recordings=[name],
        rigs=[rig.name],
        taps=list(rig.taps),
        encoders=units,
        noise_floor_pa={tap: noise[tap] for tap in rig.taps},
        noise_floor={encoder: noise[encoder] for encoder in units},
        findings=list(findings),
        rig=rig_file,
        begin_s=begin_s,
        smooth_s=smooth_s,
        observed=sensors,
        said=said_of(found),
        drifting=[
            Drifting(name=u.name, unit=u.unit, value=value, std=std, times=value / u.std)
            for u, value, std in found.drifts
        ],
    )


def said_of(found: Followed) -> list[Said]:
    """What was said to be wrong, from when until when, in the order of time.

    Args:
        found: What an observer said.
    """
    out: list[Said] = []
    open_of: dict[tuple[Literal["model", "sensor"], str], Said] = {}
    for at, wrong, matter in zip(found.time_s.tolist(), found.wrong, found.matter, strict=True):
        now: list[tuple[Literal["model", "sensor"], str, str]] = [
            ("model", _subject(words), words) for words in wrong
        ]
        now += [("sensor", sensor, words) for sensor, words in matter.items()]
        for kind, subject, words in now:
            last = open_of.get((kind, subject))
            if last is None or at - last.end_s > APART_S:
                last = Said(kind=kind, subject=subject, start_s=at, end_s=at, words=words)
                open_of[kind, subject] = last
                out.append(last)
            last.end_s, last.words = at, words
    return out


def _subject(words: str) -> str:
    """What a sentence is about: itself without its numbers, which change from moment to moment."""
    return " ".join(w for w in words.split() if not any(c.isdigit() for c in w))
