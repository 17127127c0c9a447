# SPDX-License-Identifier: Apache-2.0
"""Rigs on which every effect of the catalogue is held to what is required of all of them."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pneu_sim.effects.base import Effect
from pneu_sim.effects.proof import SAMPLE_S, Experiment, Placement, experiment_of, strongest
from pneu_sim.rig import Rig, load_rig
from pneu_sim.rig.schema import AttachedEffect, Chamber, Pipe

ROOT = Path(__file__).parents[1]


def line() -> Experiment:
    """Rig A; its spool is at its limits, so that a change of them shows."""
    rig = load_rig(ROOT / "rigs" / "rig_a.yaml")
    rig.valves["valve"].spool.max_speed_v_s = 200.0
    rig.valves["valve"].spool.max_acceleration_v_s2 = 1e5
    return experiment_of(rig, 0.2)


def bottle() -> Experiment:
    """The same with a bottle at the end of its tube."""
    rig = line().rig
    rig.pipes["tube"].to_node = "bottle"
    rig.chambers["bottle"] = Chamber(volume_m3=2e-5)
    return experiment_of(rig, 0.2)


def junction() -> Experiment:
    """The same with a branch and a stub at the end of its tube, and the tap some way before it."""
    rig = line().rig
    rig.pipes["tube"].to_node = "tee"
    for name, length_m in (("branch", 1.0), ("stub", 0.4)):
        rig.pipes[name] = Pipe.model_validate(
            {"from": "tee", "to": "closed", "length_m": length_m, "area_m2": 6e-6}
        )
    rig.taps["end"].position_m = 2.2
    return experiment_of(rig, 0.2)


def swinging(rig: Rig, head: str, rod: str, volts: float, hertz: float = 2.5) -> Experiment:
    """Two valves that work against each other, as sines."""
    time = SAMPLE_S * np.arange(200)
    nulls = {valve.command: valve.spool.null_v for valve in rig.valves.values()}
    wave = volts * np.sin(2.0 * math.pi * hertz * time)
    return Experiment(rig, {head: nulls[head] + wave, rod: nulls[rod] - wave})


def arm() -> Experiment:
    """A joint that a cylinder turns and a spring holds, so that it meets no stop.

    Without dry friction: where it stands, and when it bounces, is no smooth function of anything.
    """
    rig = load_rig(ROOT / "rigs" / "kokoro.yaml")
    rig.grid.dx_m = 0.25
    friction = rig.cylinders["forearm"].friction
    friction.coulomb_n = friction.breakaway_n = 0.0
    friction.viscous_n_s_m = 60.0
    held = {"rate": 20.0}
    rig.effects = [AttachedEffect(effect="external_spring", place="elbow", parameters=held)]
    return swinging(rig, "head", "rod", 0.5)


def cart() -> Experiment:
    """A cart that a cylinder moves along a rail."""
    return swinging(load_rig(ROOT / "rigs" / "rail.yaml"), "head", "rod", 0.15)


def short_arm() -> Experiment:
    """The joint with a cylinder so short that its piston runs into both ends."""
    rig = arm().rig
    cylinder, body = rig.cylinders["forearm"], rig.bodies["arm"]
    cylinder.stroke_m = 0.014
    body.slider.closed_length_m = math.hypot(0.160, 0.035) - 0.5 * cylinder.stroke_m
    rig.grid.dx_m = 0.1
    return swinging(rig, "head", "rod", 2.0, 5.0)


EXPERIMENTS = {one.__name__: one for one in (line, bottle, junction, arm, cart, short_arm)}


def placement_on(effect: Effect, experiments: Sequence[Experiment]) -> Placement | None:
    """The effect on the first rig on which a typical strength of it changes anything.

    Args:
        effect: The effect.
        experiments: The rigs.
    """
    for experiment in experiments:
        at = strongest(experiment, effect)
        if at is not None and np.any(at.responses([at.typical])):
            return at
    return None
