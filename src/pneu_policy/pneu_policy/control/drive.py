# SPDX-License-Identifier: Apache-2.0
"""A joint with the cylinder that moves it, and the valves on either side of that."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pneu_common.errors import InputError
from pneu_policy.control.robot_recipe import Push
from pneu_sim.rig.network import joined
from pneu_sim.rig.schema import Rig


@dataclass(frozen=True)
class Drive:
    """A joint with the cylinder that moves it and the valves on either side.

    Attributes:
        encoder: Encoder of the joint.
        cylinder: The cylinder.
        head_command: Command of the valve at its head.
        rod_command: Command of the valve at its rod side.
        push: Its taps and areas.
        null_v: Voltage at which a valve is closed, V.
    """

    encoder: str
    cylinder: str
    head_command: str
    rod_command: str
    push: Push
    null_v: float = 5.0

    def force_n(self, taps_pa: Mapping[str, float]) -> float:
        """Net force of the gas on the piston, N.

        Args:
            taps_pa: By tap its reading, Pa.
        """
        return float(self.push.force_n(taps_pa))

    @property
    def taps(self) -> tuple[str, ...]:
        """Taps that tell the force."""
        return tuple(tap for tap in (self.push.head_tap, self.push.rod_tap) if tap is not None)

    @classmethod
    def of_rig(cls, rig: Rig, encoder: str, cylinder: str, taps: tuple[str, str]) -> "Drive":
        """Finds the valves of a cylinder: those whose ports lead to its sides' lines.

        Args:
            rig: The rig.
            encoder: Encoder of the joint.
            cylinder: The cylinder.
            taps: Taps at its head and at its rod side.

        Raises:
            InputError: There is no such part, or a side has no valve of its own.
        """
        asked: tuple[tuple[str, str, Mapping[str, Any]], ...] = (
            ("encoder", encoder, rig.encoders),
            ("cylinder", cylinder, rig.cylinders),
            *(("tap", tap, rig.taps) for tap in taps),
        )
        for what, name, known in asked:
            if name not in known:
                raise InputError(
                    f"{what}: found {name!r}, rig {rig.name!r} has {', '.join(known) or 'none'}"
                )
        group = joined(rig)
        commands = []
        for side_name, side in rig.cylinders[cylinder].sides.items():
            there = group.get(side.node, side.node)
            found = [
                valve.command
                for valve in rig.valves.values()
                if any(
                    there in (group.get(p.from_node, p.from_node), group.get(p.to_node, p.to_node))
                    for p in valve.ports.values()
                )
            ]
            if len(set(found)) != 1:
                raise InputError(
                    f"cylinder: found {cylinder!r}, whose {side_name} side"
                    f" {len(set(found)) or 'no'} valves fill; eq. 9.2 needs one to each side"
                )
            commands.append(found[0])
        if len(commands) != 2 or commands[0] == commands[1]:
            raise InputError(
                f"cylinder: found {cylinder!r}, which one valve fills; eq. 9.2 needs one to each"
                " side"
            )
        nulls = {v.spool.null_v for v in rig.valves.values() if v.command in commands}
        push = Push(head_tap=taps[0], rod_tap=taps[1]).of_rig(rig, cylinder)
        return cls(encoder, cylinder, commands[0], commands[1], push, nulls.pop())
