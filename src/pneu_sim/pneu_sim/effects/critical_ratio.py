# SPDX-License-Identifier: Apache-2.0
"""Critical ratio: the port leaves choked flow at another pressure ratio than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.effects.places import flow_paths
from pneu_sim.rig.schema import Orifice, Port, Rig

HIGHEST = 0.95
"""No port stays unchoked above this; 0.528 is the ideal nozzle, more is pressure recovery."""


class CriticalRatio(Effect):
    """Error of the critical pressure ratio b, added to the rig's."""

    name: ClassVar[str] = "critical_ratio"
    title: ClassVar[str] = "error of the critical pressure ratio b"
    where: ClassVar[str] = "valve, valve port or orifice"
    formula: ClassVar[str] = (
        "b = b_rig + shift; m = m_choked sqrt(1 - ((p_2/p_1 - b) / (1 - b))^2) for p_2/p_1 > b"
    )
    source: ClassVar[str] = "ISO 6358-1:2013 (critical back-pressure ratio)"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("shift", "1", 0.0, -0.5, 0.6, 0.15, 5e-3),
    )
    order: ClassVar[int] = 3
    next_experiment: ClassVar[str] = (
        "Fill from the room all the way to supply pressure: a wrong b acts only on the last part,"
        " where downstream exceeds b times upstream, a wrong gain from the start."
    )

    def places(self, rig: Rig) -> list[str]:
        return [place for place, paths in flow_paths(rig).items() if _with_ratio(paths)]

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        if values["shift"] == 0.0:
            return
        for path in _with_ratio(flow_paths(rig)[place]):
            path.critical_ratio = min(max(path.critical_ratio + values["shift"], 0.0), HIGHEST)


def _with_ratio(paths: list[Port | Orifice]) -> list[Port | Orifice]:
    """Those that follow ISO 6358 and so have a critical ratio."""
    return [p for p in paths if isinstance(p, Orifice) or p.model == "iso6358"]
