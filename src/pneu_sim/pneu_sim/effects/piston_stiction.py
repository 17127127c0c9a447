# SPDX-License-Identifier: Apache-2.0
"""Piston stiction: at rest the seals hold against more than while the piston slides."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import moved_cylinders
from pneu_sim.rig.schema import Rig


class PistonStiction(Effect):
    """Friction at rest above that in motion, added to the rig's.

    The speed over which the whole fades is the mean of both, by their forces.
    """

    name: ClassVar[str] = "piston_stiction"
    title: ClassVar[str] = "piston that sticks"
    where: ClassVar[str] = "cylinder"
    formula: ClassVar[str] = (
        "F = force_n exp(-(v / stribeck_m_s)^2) sign(v), and at rest against as much"
    )
    source: ClassVar[str] = (
        "Stribeck 1902; Armstrong-Helouvry, Dupont and Canudas de Wit 1994, Automatica 30(7),"
        " doi:10.1016/0005-1098(94)90209-7"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("force_n", "N", 0.0, 0.0, 500.0, 8.0, 0.2),
        EffectParameter("stribeck_m_s", "m/s", 0.01, 1e-3, 0.1, 0.01, 5e-4, fitted=True),
    )
    order: ClassVar[int] = 6
    traded: ClassVar[bool] = True
    next_experiment: ClassVar[str] = (
        "Let the piston rest for some seconds, then raise the pressure slowly until it breaks"
        " away, and repeat: the force at which it starts is above that at which it goes on."
    )

    def places(self, rig: Rig) -> list[str]:
        return moved_cylinders(rig)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        friction, force = rig.cylinders[place].friction, values["force_n"]
        if force > 0.0:
            whole = friction.breakaway_n + force
            faded = friction.breakaway_n * friction.stribeck_m_s + force * values["stribeck_m_s"]
            friction.breakaway_n, friction.stribeck_m_s = whole, faded / whole
