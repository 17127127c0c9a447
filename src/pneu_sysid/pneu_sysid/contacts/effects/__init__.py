# SPDX-License-Identifier: Apache-2.0
"""The catalogue of effects of scenes: an effect is one file and one line here."""

import difflib
from functools import cache

from pneu_common.errors import InputError
from pneu_sysid.contacts.effects.air_drag import AirDrag
from pneu_sysid.contacts.effects.armature import Armature
from pneu_sysid.contacts.effects.base import SceneEffect
from pneu_sysid.contacts.effects.body_mass import BodyMass
from pneu_sysid.contacts.effects.centre_of_mass_x import CentreOfMassX
from pneu_sysid.contacts.effects.centre_of_mass_y import CentreOfMassY
from pneu_sysid.contacts.effects.centre_of_mass_z import CentreOfMassZ
from pneu_sysid.contacts.effects.clock_rate import ClockRate
from pneu_sysid.contacts.effects.contact_damping import ContactDamping
from pneu_sysid.contacts.effects.contact_friction import ContactFriction
from pneu_sysid.contacts.effects.contact_spin import ContactSpin
from pneu_sysid.contacts.effects.contact_stiffness import ContactStiffness
from pneu_sysid.contacts.effects.contact_width import ContactWidth
from pneu_sysid.contacts.effects.frame_tilt_x import FrameTiltX
from pneu_sysid.contacts.effects.frame_tilt_y import FrameTiltY
from pneu_sysid.contacts.effects.geometry_scale import GeometryScale
from pneu_sysid.contacts.effects.gravity_strength import GravityStrength
from pneu_sysid.contacts.effects.gravity_tilt_x import GravityTiltX
from pneu_sysid.contacts.effects.gravity_tilt_y import GravityTiltY
from pneu_sysid.contacts.effects.joint_damping import JointDamping
from pneu_sysid.contacts.effects.joint_friction import JointFriction
from pneu_sysid.contacts.effects.joint_load_friction import JointLoadFriction
from pneu_sysid.contacts.effects.joint_stiffness import JointStiffness
from pneu_sysid.contacts.effects.link_bend import LinkBend
from pneu_sysid.contacts.effects.remote_distance import RemoteDistance
from pneu_sysid.contacts.effects.sensor_bias import SensorBias
from pneu_sysid.contacts.effects.sensor_lag import SensorLag
from pneu_sysid.contacts.effects.sensor_scale import SensorScale
from pneu_sysid.contacts.effects.springy_tip import SpringyTip

BUILT_IN: tuple[type[SceneEffect], ...] = (
    ContactFriction,
    ContactSpin,
    ContactStiffness,
    ContactDamping,
    ContactWidth,
    RemoteDistance,
    JointFriction,
    JointLoadFriction,
    JointDamping,
    JointStiffness,
    Armature,
    SpringyTip,
    LinkBend,
    GeometryScale,
    BodyMass,
    CentreOfMassX,
    CentreOfMassY,
    CentreOfMassZ,
    GravityStrength,
    GravityTiltX,
    GravityTiltY,
    FrameTiltX,
    FrameTiltY,
    AirDrag,
    ClockRate,
    SensorScale,
    SensorBias,
    SensorLag,
)


@cache
def scene_effects() -> dict[str, SceneEffect]:
    """All effects of scenes by name."""
    return {kind.name: kind() for kind in BUILT_IN}


def find_scene_effect(name: str) -> SceneEffect:
    """An effect by its name.

    Args:
        name: Its name.

    Raises:
        InputError: There is none of that name.
    """
    known = scene_effects()
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(known)}"
        raise InputError(f"no effect of scenes is called {name!r}; {hint}")
    return known[name]
