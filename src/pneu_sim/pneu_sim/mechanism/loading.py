# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's model of a mechanism: its MJCF, and an actuator for every cylinder.

Every cylinder becomes an actuator whose control is the force along its extension, on a tendon:
the one it is bound to, or one that is added between two sites or along a joint. Length, lever and
velocity are then MuJoCo's own at every stage of its integrator, as are friction of the piston
(`frictionloss`, a constraint that holds what sticks) and its two ends (the range of the tendon).
"""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.mechanism.settings import Grip, MechanismSettings

STUCK = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Impedance of dry friction, the hardest that MuJoCo has.

Its usual one, and time of 0.02 s, let what sticks creep: 50 N on 5 kg by 10 mm/s; this one and a
time of two steps of 1 ms by 1 um/s.
"""
HARD = (0.99, 0.999, 0.0005, 0.5, 2.0)
"""Impedance of the ends of a cylinder; MuJoCo's usual one gives way by millimetres."""


@dataclass(frozen=True)
class Loaded:
    """A compiled mechanism, and where in it the parts are.

    Attributes:
        model: MuJoCo's model.
        path: Its file.
        cylinders: Numbers of the cylinders' actuators.
        tendons: Numbers of the tendons they act on.
        joints: Names of the joints of one coordinate.
        positions: Where their coordinates stand in ``qpos``.
        velocities: Where they stand in ``qvel``.
    """

    model: Any
    path: Path
    cylinders: list[int]
    tendons: list[int]
    joints: list[str]
    positions: list[int]
    velocities: list[int]


def mujoco_module() -> ModuleType:
    """Returns MuJoCo, with its batches.

    Raises:
        InputError: It is not installed, or too old.
    """
    try:
        import mujoco
        import mujoco.batch
    except ImportError as error:
        raise InputError(
            f"a mechanism (mjcf) needs MuJoCo 3.17 or newer, which is not installed ({error}):"
            " `pip install '.[robots]'` in a checkout of pneu, or 'FILE.whl[robots]' for a wheel of"
            " it"
        ) from None
    return mujoco


def load(settings: MechanismSettings, folder: str | Path) -> Loaded:
    """Reads an MJCF and binds cylinders to it.

    Args:
        settings: What the rig says.
        folder: Folder that the MJCF's path is relative to.

    Raises:
        InputError: MuJoCo is missing, the MJCF cannot be compiled, or a cylinder not be bound.
    """
    mujoco = mujoco_module()
    path = Path(folder) / settings.mjcf
    if not path.is_file():
        raise InputError(f"{path}: mjcf: there is no such file")
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compile()  # before anything is added: its faults are told as its own
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo cannot compile it: {_one_line(error)}") from None
    _check_flags(mujoco, spec, path)
    names = [_bind(mujoco, spec, path, n, grip) for n, grip in settings.cylinders.items()]
    if settings.step_s is not None:
        spec.option.timestep = settings.step_s
    if settings.coupling == "second_order":
        # MuJoCo's other integrators are of first order in what depends on velocity.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    # A rig that becomes unstable is to be not finite, not back at its beginning.
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    try:
        model = spec.compile()
    except ValueError as error:
        raise InputError(
            f"{path}: MuJoCo cannot compile it with its cylinders: {_one_line(error)}"
        ) from None
    for name, grip in settings.cylinders.items():
        if grip.sites:
            one, two = (int(model.site(site).bodyid[0]) for site in grip.sites)
            if model.body_weldid[one] == model.body_weldid[two]:
                raise InputError(
                    f"{path}: cylinders.{name}.sites: found {' and '.join(map(repr, grip.sites))},"
                    " which do not move against one another, sites of different bodies are needed"
                )
    tendons = [model.tendon(name).id for name in names]
    hold = max(2.0 * model.opt.timestep, 1e-6)
    model.tendon_solref_fri[tendons] = hold, 1.0
    model.tendon_solimp_fri[tendons] = STUCK
    model.tendon_solref_lim[tendons] = max(hold, 0.002), 1.0
    model.tendon_solimp_lim[tendons] = HARD
    scalar = [int(kind) for kind in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)]
    joints = [j for j in range(model.njnt) if model.jnt_type[j] in scalar]
    return Loaded(
        model=model,
        path=path,
        cylinders=[model.actuator(_added(name)).id for name in settings.cylinders],
        tendons=tendons,
        joints=[model.joint(j).name or f"joint_{j}" for j in joints],
        positions=[int(model.jnt_qposadr[j]) for j in joints],
        velocities=[int(model.jnt_dofadr[j]) for j in joints],
    )


def _one_line(error: Exception) -> str:
    """What MuJoCo says, on one line."""
    return " ".join(str(error).split()).removeprefix("Error: ")


def _added(cylinder: str) -> str:
    """Name of what is added for a cylinder."""
    return f"cylinder {cylinder}"


def _check_flags(mujoco: ModuleType, spec: Any, path: Path) -> None:
    """Refuses a model that has switched off what cylinders are made of."""
    bits = mujoco.mjtDisableBit
    for flag, bit in (
        ("actuation", bits.mjDSBL_ACTUATION),
        ("constraint", bits.mjDSBL_CONSTRAINT),
        ("frictionloss", bits.mjDSBL_FRICTIONLOSS),
        ("limit", bits.mjDSBL_LIMIT),
    ):
        if spec.option.disableflags & int(bit):
            raise InputError(
                f"{path}: option/flag: found {flag}=disable, cylinders need it enabled"
            )


def _bind(mujoco: ModuleType, spec: Any, path: Path, name: str, grip: Grip) -> str:
    """Adds the actuator of a cylinder; returns the tendon it acts on."""
    tendon = _tendon(mujoco, spec, path, name, grip)
    # What is added takes over the MJCF's defaults, here all overwritten.
    actuator = spec.add_actuator(name=_added(name), target=tendon)
    actuator.trntype = mujoco.mjtTrn.mjTRN_TENDON
    actuator.set_to_motor()
    actuator.gear = [grip.gear, 0.0, 0.0, 0.0, 0.0, 0.0]
    never = mujoco.mjtLimited.mjLIMITED_FALSE
    actuator.ctrllimited = actuator.forcelimited = actuator.actlimited = never
    actuator.damping, actuator.armature = [0.0, 0.0, 0.0], 0.0
    actuator.delay, actuator.nsample = 0.0, 0
    off = spec.option.disableactuator
    actuator.group = next(group for group in range(31) if not off >> group & 1)
    return tendon


def _tendon(mujoco: ModuleType, spec: Any, path: Path, name: str, grip: Grip) -> str:
    """Returns the tendon that a cylinder acts on, added where there is none."""
    where = f"{path}: cylinders.{name}"
    if grip.tendon is not None:
        _known(spec.tendon, spec.tendons, where, "tendon", grip.tendon)
        return grip.tendon
    if grip.joint is not None:
        joint = _known(spec.joint, spec.joints, where, "joint", grip.joint)
        if joint.type not in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE):
            kind = "ball" if joint.type == mujoco.mjtJoint.mjJNT_BALL else "free"
            raise InputError(
                f"{where}.joint: found {grip.joint!r}, a {kind} joint, a hinge or a slide is needed"
            )
    for site in grip.sites or ():
        _known(spec.site, spec.sites, where, "sites", site)
    tendon = spec.add_tendon(name=_added(name))
    tendon.stiffness = tendon.damping = [0.0, 0.0, 0.0]
    tendon.frictionloss = tendon.armature = tendon.margin = 0.0
    tendon.limited = tendon.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    if grip.joint is not None:
        tendon.wrap_joint(grip.joint, 1.0)
    for site in grip.sites or ():
        tendon.wrap_site(site)
    return _added(name)


def _known(find: Any, all_of: Any, where: str, field: str, name: str) -> Any:
    """An element of a specification by its name."""
    found = find(name)
    if found is None:
        known = ", ".join(repr(one.name) for one in all_of if one.name) or "none with a name"
        raise InputError(f"{where}.{field}: found {name!r}, the MJCF has {known}")
    return found


def id_of(loaded: Loaded, kind: str, field: str, name: str) -> int:
    """Number of a part of the model.

    Args:
        loaded: The mechanism.
        kind: ``body``, ``joint`` or ``key``.
        field: The field of the rig that names it.
        name: Its name.

    Raises:
        InputError: There is none.
    """
    mujoco = mujoco_module()
    number = mujoco.mj_name2id(loaded.model, getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}"), name)
    if number < 0:
        count = {"body": "nbody", "joint": "njnt", "key": "nkey"}[kind]
        names = (getattr(loaded.model, kind)(i).name for i in range(getattr(loaded.model, count)))
        known = ", ".join(repr(one) for one in names if one) or "none with a name"
        raise InputError(f"{loaded.path}: {field}: found {name!r}, the MJCF has {known}")
    return int(number)


def scalar_joint(loaded: Loaded, field: str, name: str) -> int:
    """Number, among the joints of one coordinate, of a joint.

    Args:
        loaded: The mechanism.
        field: The field of the rig that names it.
        name: Its name.

    Raises:
        InputError: There is none, or it has more than one coordinate.
    """
    id_of(loaded, "joint", field, name)
    if name not in loaded.joints:
        raise InputError(
            f"{loaded.path}: {field}: found {name!r}, a ball or free joint, a hinge or a slide is"
            " needed"
        )
    return loaded.joints.index(name)


def limit(loaded: Loaded, cylinder: int, low: Any, high: Any) -> Any:
    """What is left of the range of a cylinder's tendon, with the ends of the cylinder.

    Args:
        loaded: The mechanism; the tendon is limited from now on.
        cylinder: Number of the cylinder.
        low: (lanes,) length of the tendon at one end, m.
        high: (lanes,) at the other.

    Returns:
        (lanes, 2) least and greatest length, m.
    """
    t, model = loaded.tendons[cylinder], loaded.model
    least, most = np.minimum(low, high), np.maximum(low, high)
    if model.tendon_limited[t]:
        own = model.tendon_range[t]
        least, most = np.maximum(least, own[0]), np.minimum(most, own[1])
    model.tendon_limited[t] = 1
    return np.stack([least, most], axis=-1)
