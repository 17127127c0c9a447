# SPDX-License-Identifier: Apache-2.0
"""Wall compliance: a soft tube widens under pressure and slows the waves in it."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class WallCompliance(Effect):
    """Relative growth of the cross-section per pascal, added to the rig's."""

    name: ClassVar[str] = "wall_compliance"
    title: ClassVar[str] = "yielding tube wall"
    where: ClassVar[str] = "pipe"
    formula: ClassVar[str] = (
        "A = A_rig s, s = 1 + kappa (p - p_room), kappa = compliance_per_pa;"
        " wave speed c / sqrt(1 + gamma p kappa / s)"
    )
    source: ClassVar[str] = (
        "Korteweg 1878, Ann. Phys. 241, 525-542; Wylie and Streeter, Fluid Transients in Systems,"
        " 1993"
    )
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("compliance_per_pa", "1/Pa", 0.0, 0.0, 2e-6, 1e-7, 4e-9),
    )
    order: ClassVar[int] = 5
    next_experiment: ClassVar[str] = (
        "Time small pulses between two taps at several mean pressures: in a yielding tube they slow"
        " down as pressure rises, in a stiff one their speed does not depend on pressure."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        rig.pipes[place].wall.compliance_per_pa += values["compliance_per_pa"]
