# SPDX-License-Identifier: Apache-2.0
"""A rig whose commands reach the valves later than its file knows: by bus and controller."""

from pneu_sim.rig.schema import AttachedEffect, Rig


def with_delay(rig: Rig, delay_s: float) -> Rig:
    """The rig with a delay of all its valves beyond their own.

    Args:
        rig: The rig.
        delay_s: The delay, s; 0 is none.
    """
    if delay_s <= 0.0:
        return rig
    late = [
        AttachedEffect(effect="valve_delay", place=valve, parameters={"delay_s": delay_s})
        for valve in rig.valves
    ]
    return rig.model_copy(update={"effects": [*rig.effects, *late]})
