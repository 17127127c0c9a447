# SPDX-License-Identifier: Apache-2.0
"""Pieces of commands of several kinds, drawn at random within limits.

What tells one number of a rig from another differs from number to number: edges tell delays, small
openings tell dead bands and leakage, what is held tells leaks, slow sweeps tell gains, fast waves
tell volumes and losses. So pieces are drawn of all kinds, and the best are chosen.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig.schema import Rig
from pneu_sysid.design.limits import Limits, slewed

Floats = NDArray[np.float64]
Kind = Literal["steps", "multisine", "sweep", "decay", "reversal"]
KINDS: tuple[Kind, ...] = get_args(Kind)
Choice = Literal["steps", "multisine", "sweep", "decay", "reversal", "tracking"]
CHOICES: tuple[Choice, ...] = get_args(Choice)
"""What may be asked for: a kind of piece, or what a controller sends (`tracking.track`)."""

STEP_S = 5e-3
"""Commands change on a grid of this interval; a spool takes several."""
SHORTEST_S, LONGEST_S = 0.02, 0.6
"""Of levels that are held."""
SINES = 5
SLOWEST_HZ, FASTEST_HZ = 0.4, 25.0
"""Of the sines of a multisine."""
SMALL = 0.08
"""Least swing of a piece, as a share of what is allowed: around null."""


def nulls_of(rig: Rig) -> dict[str, float]:
    """Voltage at which the valves of each command close.

    Args:
        rig: The rig.
    """
    return {valve.command: valve.spool.null_v for valve in rig.valves.values()}


def shut(rig: Rig, limits: Limits, seconds: float) -> dict[str, Floats]:
    """Commands that shut all valves, or as nearly as they may.

    Args:
        rig: The rig.
        limits: What is kept to.
        seconds: How long, s.

    Returns:
        Per command its (T,) volts, every ``STEP_S``.
    """
    nulls = nulls_of(rig)
    return {
        name: np.full(
            round(seconds / STEP_S),
            np.clip(nulls.get(name, 0.5 * (limits.low_v[name] + high)), limits.low_v[name], high),
        )
        for name, high in limits.high_v.items()
    }


def draw_piece(
    rig: Rig, limits: Limits, seconds: float, kind: Kind, rng: np.random.Generator
) -> dict[str, Floats]:
    """Commands of one kind.

    Of several commands each moves by itself, or every second one as the mirror image of the one
    before, as the two sides of a piston need it, or one alone while the others stand still.

    Args:
        rig: The rig.
        limits: What is kept to.
        seconds: How long, s.
        kind: Which.
        rng: Of the draws.

    Returns:
        Per command its (T,) volts, every ``STEP_S``.
    """
    samples = round(seconds / STEP_S)
    nulls = nulls_of(rig)
    shapes: list[Floats] = []
    together = str(rng.choice(["own", "opposed", "alone"]))
    mover = int(rng.integers(len(rig.commands)))
    out = {}
    for k, command in enumerate(rig.commands):
        low, high = limits.low_v[command], limits.high_v[command]
        null = float(np.clip(nulls.get(command, 0.5 * (low + high)), low, high))
        if together == "opposed" and k % 2:
            shape = -shapes[-1]
        elif together == "alone" and k != mover:
            shape = np.full(samples, rng.choice([-1.0, 0.0, 1.0]) * rng.uniform())
        else:
            shape = SHAPES[kind](samples, rng)
        shapes.append(shape)
        # from null as far down as up it would be, so that small waves stay where the valve closes
        volts = np.where(shape >= 0.0, null + shape * (high - null), null + shape * (null - low))
        out[command] = slewed(np.clip(volts, low, high), STEP_S, limits)
    return out


def _swing(rng: np.random.Generator) -> float:
    """How far a piece goes of what is allowed: as often little as much."""
    return float(np.exp(rng.uniform(np.log(SMALL), 0.0)))


def _steps(samples: int, rng: np.random.Generator) -> Floats:
    swing, centre = _swing(rng), float(rng.uniform(-0.3, 0.3))
    usual = float(np.exp(rng.uniform(np.log(2.0 * SHORTEST_S), np.log(LONGEST_S))))
    out = np.empty(samples)
    at = 0
    while at < samples:
        hold = max(round(usual * rng.uniform(0.5, 1.5) / STEP_S), 1)
        out[at : at + hold] = centre + swing * rng.uniform(-1.0, 1.0)
        at += hold
    return np.clip(out, -1.0, 1.0)


def _multisine(samples: int, rng: np.random.Generator) -> Floats:
    time = STEP_S * np.arange(samples)
    hertz = np.exp(rng.uniform(np.log(SLOWEST_HZ), np.log(FASTEST_HZ), SINES))
    phase = rng.uniform(0.0, 2.0 * np.pi, SINES)
    size = rng.uniform(0.4, 1.0, SINES)
    wave = np.sin(2.0 * np.pi * hertz * time[:, None] + phase) @ size
    wave /= max(float(np.max(np.abs(wave))), 1e-9)
    return np.clip(rng.uniform(-0.3, 0.3) + _swing(rng) * wave, -1.0, 1.0)


def _sweep(samples: int, rng: np.random.Generator) -> Floats:
    """Slowly from one end to the other, and perhaps back: everywhere nearly at rest."""
    swing, sign = max(_swing(rng), 0.3), float(rng.choice([-1.0, 1.0]))
    turn = float(rng.uniform(0.4, 1.0))
    x = np.linspace(0.0, 1.0, samples)
    there = np.where(x < turn, x / turn, 1.0 - (x - turn) / max(1.0 - turn, 1e-9) * 0.8)
    return np.asarray(sign * swing * (2.0 * there - 1.0))


def _decay(samples: int, rng: np.random.Generator) -> Floats:
    """Filled or emptied, then shut: what passes a shut valve, or a wall, is seen alone."""
    out = np.zeros(samples)
    move = max(round(rng.uniform(0.1, 0.4) * samples), 1)
    out[:move] = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0)
    return out


def _reversal(samples: int, rng: np.random.Generator) -> Floats:
    swing = max(_swing(rng), 0.2)
    half = max(round(np.exp(rng.uniform(np.log(0.04), np.log(0.5))) / STEP_S), 1)
    sign = 1.0 if rng.uniform() < 0.5 else -1.0
    return np.asarray(sign * swing * np.where(np.arange(samples) // half % 2, -1.0, 1.0))


SHAPES: dict[Kind, Callable[[int, np.random.Generator], Floats]] = {
    "steps": _steps,
    "multisine": _multisine,
    "sweep": _sweep,
    "decay": _decay,
    "reversal": _reversal,
}
"""(T,) between -1 and 1: 0 is shut, 1 the highest voltage, -1 the lowest."""


def joined(pieces: Sequence[Mapping[str, Floats]], limits: Limits) -> dict[str, Floats]:
    """Pieces one after the other.

    Args:
        pieces: Per command volts every ``STEP_S``.
        limits: What is kept to where they meet.
    """
    return {
        command: slewed(np.concatenate([piece[command] for piece in pieces]), STEP_S, limits)
        for command in pieces[0]
    }
