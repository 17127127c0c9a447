# SPDX-License-Identifier: Apache-2.0
"""Length error: a line is longer or shorter than the rig says."""

from typing import ClassVar

from pneu_sim.effects.base import Effect, EffectParameter
from pneu_sim.rig.schema import Rig


class LengthError(Effect):
    """Relative error of a pipe's length; what sits on the pipe is stretched with it."""

    name: ClassVar[str] = "length_error"
    title: ClassVar[str] = "error of a line's length"
    where: ClassVar[str] = "pipe"
    stage: ClassVar[int] = 1
    formula: ClassVar[str] = "L = L_rig (1 + error), positions on the pipe likewise"
    source: ClassVar[str] = "geometry; wave arrival time L / c"
    parameters: ClassVar[tuple[EffectParameter, ...]] = (
        EffectParameter("error", "relative", 0.0, -0.3, 0.5, 0.04, 1.5e-3),
    )
    order: ClassVar[int] = 3
    next_experiment: ClassVar[str] = (
        "Measure the tube with a tape; or time a sharp pulse to its far end and back: length shifts"
        " the arrival and all modes by one factor, area leaves them."
    )

    def places(self, rig: Rig) -> list[str]:
        return list(rig.pipes)

    def on_rig(self, rig: Rig, place: str, values: dict[str, float]) -> None:
        if values["error"] == 0.0:
            return
        factor = 1.0 + values["error"]
        pipe = rig.pipes[place]
        # The cells stretch with the pipe, so that their number does not jump.
        cells = max(2, round(pipe.length_m / (pipe.dx_m or rig.grid.dx_m)))
        pipe.length_m *= factor
        pipe.dx_m = pipe.length_m / cells
        for parts in (pipe.losses, pipe.leaks, pipe.reliefs, pipe.volumes, pipe.narrowings):
            for part in parts:
                part.position_m *= factor
        if pipe.area_profile is not None:
            pipe.area_profile = [(x * factor, area) for x, area in pipe.area_profile]
        for tap in rig.taps.values():
            if tap.pipe == place:
                tap.position_m *= factor
