# SPDX-License-Identifier: Apache-2.0
"""Topics on which readings of a rig's encoders arrive; ``pneu_sim.topics`` has those of taps."""

from dataclasses import dataclass
from typing import Any

from pneu_sim.rig.schema import Rig
from pneu_sim.topics import FLOAT64, JOINT_STATE


@dataclass(frozen=True)
class EncoderTopic:
    """One topic and the encoders that its messages tell of.

    Attributes:
        name: Topic, relative or absolute.
        type: Message type in its long form: ``JointState``, or ``Float64``.
        encoders: Per encoder the rad or m per raw unit, and its reading at raw zero.
    """

    name: str
    type: str
    encoders: dict[str, tuple[float, float]]

    def read(self, message: Any) -> dict[str, float]:
        """What a message says of the encoders: by their names, where it has names.

        Args:
            message: Message of this topic.

        Returns:
            Readings by encoder, rad or m, of those that the message has a number for.
        """
        if self.type == FLOAT64:
            said = dict.fromkeys(self.encoders, float(message.data))
        else:
            said = dict(zip(message.name, map(float, message.position), strict=False))
        return {
            name: scale * said[name] + offset
            for name, (scale, offset) in self.encoders.items()
            if name in said
        }


def encoder_topics(rig: Rig) -> list[EncoderTopic]:
    """Topics on which the readings of a rig's encoders arrive.

    Args:
        rig: The rig.
    """
    found: dict[str, EncoderTopic] = {}
    for name, encoder in rig.encoders.items():
        channel = encoder.recorded
        if channel.topic is None:
            continue
        kind = FLOAT64 if channel.field == "data" else JOINT_STATE
        topic = found.setdefault(channel.topic, EncoderTopic(channel.topic, kind, {}))
        topic.encoders[name] = channel.scale, channel.offset
    return list(found.values())
