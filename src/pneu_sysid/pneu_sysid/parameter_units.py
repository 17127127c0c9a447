# SPDX-License-Identifier: Apache-2.0
"""The unit of a number of a rig, told by its path: the file has it in the key's name."""

from pneu_sim.effects.base import Effect
from pneu_sim.effects.registry import registry
from pneu_sim.rig.schema import Rig
from pneu_sysid.sensor_units import encoder_unit, encoder_units, joints_of

PURE = frozenset({
        "centre_opening", "cfl", "critical_ratio", "damping", "discharge",
        "exhaust_critical_ratio", "exponent", "fraction", "friction_coefficient", "gain",
        "gas_friction", "gear", "heat_kappa", "heat_turbulent", "heat_unsteady", "inlet_head",
        "inlet_loss", "integral", "jet_loss", "k", "laminar", "laminar_ratio", "laminar_share",
        "laminar_widening", "leakage", "loss_from", "loss_to", "nusselt", "onset_reynolds",
        "opening", "port_critical_ratio", "turbulent", "turbulent_fade", "unsteady",
    })  # fmt: skip
"""Numbers without a unit."""
JOINT = {
    "start": ("rad", "m"),
    "lower": ("rad", "m"),
    "upper": ("rad", "m"),
    "viscous": ("N m s/rad", "N s/m"),
    "dry_friction": ("N m", "N"),
    "stop_stiffness": ("N m/rad", "N/m"),
    "stop_damping": ("N m s/rad", "N s/m"),
    "stop_hold": ("1", "1"),
    "spring": ("N m/rad", "N/m"),
    "spring_at": ("rad", "m"),
    "play": ("rad", "m"),
}
"""Numbers of a joint, and their units where it turns and where it slides."""
ENCODER = frozenset({"bias", "noise", "quantum"})
"""Numbers of an encoder in the unit of what it reads."""
SUFFIXES = (
    ("_m3_rad", "m^3/rad"),
    ("_n_per_pa", "N/Pa"),
    ("_n_s_m", "N s/m"),
    ("_m_n", "m/N"),
    ("_kg_m2", "kg m^2"),
    ("_w_m2_k", "W/(m^2 K)"),
    ("_m_s2", "m/s^2"),
    ("_n_m", "N/m"),
    ("_n", "N"),
    ("_m3_s_pa", "m^3/(s Pa)"),
    ("_m3_per_pa", "m^3/Pa"),
    ("_pa_s_per_kg", "Pa s/kg"),
    ("_pa_s_m", "Pa s/m"),
    ("_w_per_k", "W/K"),
    ("_per_pa", "1/Pa"),
    ("_v_s2", "V/s^2"),
    ("_v_s", "V/s"),
    ("_m_s", "m/s"),
    ("_m3", "m^3"),
    ("_m2", "m^2"),
    ("_rad", "rad"),
    ("_hz", "Hz"),
    ("_pa", "Pa"),
    ("_kg", "kg"),
    ("_k", "K"),
    ("_m", "m"),
    ("_s", "s"),
    ("_v", "V"),
)
"""Ends of names and the units they stand for; the longer first, which end in the shorter."""


def unit_of_parameter(rig: Rig, path: str) -> str | None:
    """The unit of a number of a rig.

    Args:
        rig: The rig.
        path: Dotted path, in which ``*`` may stand for any part.

    Returns:
        The unit, powers after a caret; ``1`` for a pure number, None for what is not known.
    """
    parts = path.split(".")
    if len(parts) == 4 and (parts[0], parts[2]) == ("effects", "parameters"):
        return _of_effect(rig, parts[1], parts[3])
    if len(parts) == 4 and parts[0] == "bodies" and parts[3] in JOINT:
        body = rig.bodies.get(parts[1])
        slides = body is not None and parts[2] in body.slides
        return JOINT[parts[3]][slides]
    if len(parts) == 3 and parts[0] == "encoders" and parts[2] in ENCODER:
        return encoder_units(rig).get(parts[1])
    named = [part for part in parts if not part.isdigit()]
    return unit_of_name(named[-1]) if named else None


def unit_of_name(name: str) -> str | None:
    """The unit of what has a name: that of its end.

    Args:
        name: The last part of a path that is no place in a list.
    """
    if name in PURE:
        return "1"
    return next((unit for end, unit in SUFFIXES if name.endswith(end)), None)


def _of_effect(rig: Rig, place: str, name: str) -> str | None:
    """The unit that the catalogue has for a parameter of an attached effect."""
    if not place.isdigit() or int(place) >= len(rig.effects):
        return unit_of_name(name)
    attached = rig.effects[int(place)]
    effect = registry().get(attached.effect)
    known = () if effect is None else effect.parameters
    units = (_own(rig, p.unit, attached.place) for p in known if p.name == name)
    return next(units, unit_of_name(name))


def strength_unit(rig: Rig, effect: Effect, place: str) -> str:
    """The unit of an effect's strength at a place.

    Args:
        rig: The rig.
        effect: The effect.
        place: The place.
    """
    return _own(rig, effect.strength.unit, place)


def _own(rig: Rig, unit: str, place: str) -> str:
    """Of two units that the catalogue has, for what turns and for what slides, a place's own."""
    options = unit.split(" or ")
    if len(options) == 1:
        return unit
    if place in rig.encoders:
        slides = encoder_unit(rig, place) == "m"
    elif place in (joints := joints_of(rig)):
        slides = joints[place][1] == "m"
    else:
        slides = rig.cylinders[place.split(".", 1)[0]].rotary is None
    turning = next(o for o in options if "rad" in o or "N m" in o)
    return next(o for o in options if (o == turning) != slides)
