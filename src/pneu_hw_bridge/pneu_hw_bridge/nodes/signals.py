# SPDX-License-Identifier: Apache-2.0
"""On which topics a bridge hears commands and tells readings, and what a message commands."""

from typing import Any

from pneu_common.errors import InputError
from pneu_hw_bridge.registers.schema import RegisterMap
from pneu_sim import topics
from pneu_sim.rig.schema import Rig


def topics_of(
    rig: Rig | None, registers: RegisterMap
) -> tuple[list[topics.Topic], list[topics.Topic], list[topics.Topic]]:
    """Topics of the commands, the taps and the encoders of a register map.

    Args:
        rig: The rig whose channels say where they are; None is where they usually are.
        registers: The register map, which names them.

    Returns:
        Of the commands, of the taps, and of the encoders.

    Raises:
        InputError: The rig names other commands or lacks a tap or an encoder.
    """
    outputs, taps, encoders = (
        list(of) for of in (registers.outputs, registers.taps, registers.encoders)
    )
    if rig is None:
        return (
            topics.usual_command_topics(outputs),
            topics.usual_tap_topics(taps),
            topics.usual_encoder_topics(encoders),
        )
    for what, mine, of_rig in (
        ("command", sorted(set(outputs) ^ set(rig.commands)), rig.commands),
        ("tap", sorted(set(taps) - set(rig.taps)), rig.taps),
        ("encoder", sorted(set(encoders) - set(rig.encoders)), rig.encoders),
    ):
        if mine:
            raise InputError(
                f"rig {rig.name!r} and register map {registers.name!r} differ in {what}"
                f" {mine[0]!r}; the rig has {', '.join(of_rig) or 'none'}"
            )
    found = topics.command_topics(rig), topics.only(topics.tap_topics(rig), taps)
    topics.check_joints_topic(rig, (*found[0], *found[1]))
    return (*found, topics.only(topics.encoder_topics(rig), encoders))


def told(topic: topics.Topic, message: Any) -> tuple[dict[str, float], str]:
    """What a message commands.

    Args:
        topic: The topic that it came on.
        message: The message.

    Returns:
        Volts by name, also those of names that nobody knows; and why it cannot be read, empty where
        it can.
    """
    if topic.type != topics.VALVE_COMMAND:
        return topic.read(message), ""
    names, voltages = list(message.name), list(message.voltage_v)
    if len(names) != len(voltages) or len(set(names)) != len(names):
        return {}, f"{len(names)} names and {len(voltages)} voltages, needed are pairs"
    scaled = topic.read(message)
    return {n: scaled.get(n, float(v)) for n, v in zip(names, voltages, strict=True)}, ""
