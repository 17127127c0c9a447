# SPDX-License-Identifier: Apache-2.0
"""What a rig file may say of what holds gas: pipes and what sits on them, reservoirs, chambers."""

from typing import Annotated

from pydantic import Field

from pneu_sim.parts import Finite, NonNegative, Part, Positive


class Wall(Part):
    """How a pipe wall acts on the gas.

    Attributes:
        laminar: Factor on laminar drag 8 pi mu u; the thesis as printed (4 pi mu u) is 0.5.
        turbulent: Gain on what turbulence adds to the drag (Haaland); 0 is laminar throughout.
        onset_reynolds: Reynolds number at which turbulence sets in; full at 1.74 times that.
        roughness_m: Height of the wall's roughness.
        unsteady: Factor on frequency-dependent friction (Zielke).
        turbulent_fade: Gain on how much faster the memory of friction and heat fades in turbulent
            flow; 1 is Vardy and Brown (2003), 0 as in laminar flow.
        nusselt: Nusselt number of quasi-steady wall heat, on the section's mean temperature; 8 is
            the limit that belongs to the unsteady kernel, 3.66 the developed flow at constant wall
            temperature, 0 (with no gain on what follows) an adiabatic wall.
        heat_turbulent: Gain on what turbulence adds to wall heat (Gnielinski).
        heat_unsteady: Factor on frequency-dependent wall heat.
        heat_kappa: Conductivity of thesis eq. 5.3, W/(m^2 K); replaces ``nusselt`` where given.
        compliance_per_pa: Relative growth of the cross-section per pascal.
    """

    laminar: NonNegative = 1.0
    turbulent: NonNegative = 1.0
    onset_reynolds: Positive = 2300.0
    roughness_m: NonNegative = 0.0
    unsteady: NonNegative = 1.0
    turbulent_fade: NonNegative = 1.0
    nusselt: NonNegative = 8.0
    heat_turbulent: NonNegative = 1.0
    heat_unsteady: NonNegative = 1.0
    heat_kappa: NonNegative | None = None
    compliance_per_pa: NonNegative = 0.0


class LocalLoss(Part):
    """A fitting or valve body in a pipe.

    Attributes:
        position_m: Where it sits.
        k: Velocity heads it costs (turbulent).
        resistance_pa_s_m: Pressure drop per velocity (viscous), the "added viscosity just for the
            valve-adjacent cell" of thesis 5.4.
    """

    position_m: NonNegative
    k: NonNegative = 0.0
    resistance_pa_s_m: NonNegative = 0.0


class Leak(Part):
    """A way to the room in a pipe's wall: a hole, or something porous (a seal, a thread).

    Attributes:
        position_m: Where it sits.
        area_m2: Effective area of an orifice.
        porous_m3: Permeability x area / length of a porous plug; of a capillary of diameter d and
            length l, pi d^4 / (128 l). It leaks porous_m3 (p^2 - p_room^2) / (2 mu R T).
    """

    position_m: NonNegative
    area_m2: NonNegative = 0.0
    porous_m3: NonNegative = 0.0


class Relief(Part):
    """A relief valve: an orifice to the room that opens above a set pressure.

    Attributes:
        area_m2: Effective area fully open.
        set_pa: Pressure at which it begins to open.
        range_pa: By how much more it is fully open; between, the area grows in proportion.
    """

    area_m2: NonNegative
    set_pa: Positive
    range_pa: Positive = 2e4


class PipeRelief(Relief):
    """A relief valve on a pipe.

    Attributes:
        area_m2: Effective area fully open.
        set_pa: Pressure at which it begins to open.
        range_pa: By how much more it is fully open; between, the area grows in proportion.
        position_m: Where it sits.
    """

    position_m: NonNegative


class Ripple(Part):
    """A pulsation of a reservoir's pressure: a compressor's strokes, a regulator that hunts.

    Attributes:
        amplitude_pa: Its amplitude, half of peak to peak.
        frequency_hz: Its frequency.
        phase_rad: Phase of its sine at time zero of the simulation or recording.
    """

    amplitude_pa: NonNegative
    frequency_hz: Positive
    phase_rad: Finite = 0.0


class DeadVolume(Part):
    """A volume that hangs on a pipe: a fitting, a sensor's cavity.

    Attributes:
        position_m: Where it sits.
        volume_m3: Its volume.
    """

    position_m: NonNegative
    volume_m3: NonNegative


class Narrowing(Part):
    """A stretch of a pipe with less area: a kink, a blockage.

    Attributes:
        position_m: Its middle.
        length_m: Its length.
        fraction: Share of the area that is lost.
    """

    position_m: NonNegative
    length_m: Positive = 0.1
    fraction: Annotated[float, Field(ge=0.0, le=0.98)]


class Pipe(Part):
    """A line between two nodes.

    Attributes:
        from_node: Node at position 0.
        to_node: Node at position ``length_m``.
        length_m: Length.
        area_m2: Cross-section.
        area_profile: Optional (position, area) corners of a cross-section that varies linearly.
        dx_m: Cell length, where it differs from the grid's.
        wall: Friction and heat.
        losses: Local losses.
        leaks: Leaks to the room.
        reliefs: Relief valves.
        volumes: Dead volumes.
        narrowings: Stretches of reduced area.
        volume_from_m3: Volume at the ``from`` end (a valve's chamber, a fitting).
        volume_to_m3: Volume at the ``to`` end.
        loss_from: Velocity heads lost at the ``from`` end (a fitting, this branch of a junction).
        loss_to: Velocity heads lost at the ``to`` end.
    """

    from_node: str = Field(alias="from")
    to_node: str = Field(alias="to")
    length_m: Positive
    area_m2: Positive
    area_profile: list[tuple[NonNegative, Positive]] | None = None
    dx_m: Positive | None = None
    wall: Wall = Wall()
    losses: list[LocalLoss] = []
    leaks: list[Leak] = []
    reliefs: list[PipeRelief] = []
    volumes: list[DeadVolume] = []
    narrowings: list[Narrowing] = []
    volume_from_m3: NonNegative = 0.0
    volume_to_m3: NonNegative = 0.0
    loss_from: NonNegative = 0.0
    loss_to: NonNegative = 0.0


class Reservoir(Part):
    """A source or sink of constant state: compressor, regulator, room.

    Attributes:
        pressure_pa: Pressure at no flow.
        temperature_k: Temperature; None is the room's.
        droop_pa_s_per_kg: Sag of the pressure per flow drawn.
        droop_tau_s: Time constant of the sag.
        inlet_loss: Velocity heads lost where gas enters a pipe (0 rounded, 0.5 sharp).
        ripples: Pulsations of its pressure, added up. Lumped models have them only
            where pistons move.
        room: Whether it is the room, rather than a source or a vacuum; not given, it is where its
            pressure is that of `ambient` as the file is read.
    """

    pressure_pa: Positive
    temperature_k: Positive | None = None
    droop_pa_s_per_kg: NonNegative = 0.0
    droop_tau_s: NonNegative = 0.002
    inlet_loss: NonNegative = 0.0
    ripples: list[Ripple] = []
    room: bool | None = None


class Chamber(Part):
    """A well-mixed volume.

    Attributes:
        volume_m3: Volume at the room's pressure.
        compliance_m3_per_pa: Growth of the volume per pascal above the room (a test lung).
        heat_w_per_k: Heat conductance of its wall.
        convection_m2: Area of its wall along which the gas convects: Nu = 0.56 Re^0.67 + 0.104
            Ra^0.352 of the jet that enters and of the gas's height.
        height_m: Height of its gas for that; none is the edge of a cube of its volume.
        inlet_m: Diameter of the jet that enters; none is one that stirs nothing.
        leak_area_m2: Effective area of its leak to the room.
        leak_porous_m3: Permeability x area / length of a porous leak to the room, see a pipe's.
        reliefs: Relief valves.
    """

    volume_m3: Positive
    compliance_m3_per_pa: NonNegative = 0.0
    heat_w_per_k: NonNegative = 0.0
    convection_m2: NonNegative = 0.0
    height_m: Positive | None = None
    inlet_m: Positive | None = None
    leak_area_m2: NonNegative = 0.0
    leak_porous_m3: NonNegative = 0.0
    reliefs: list[Relief] = []
