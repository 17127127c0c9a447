# SPDX-License-Identifier: Apache-2.0
"""Which effects there are: built-in ones, those of installed packages, those of a user's file."""

import functools
import importlib.util
import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from pneu_common.errors import InputError
from pneu_sim.effects.ambient_pressure import AmbientPressure
from pneu_sim.effects.ambient_temperature import AmbientTemperature
from pneu_sim.effects.area_error import AreaError
from pneu_sim.effects.backlash import Backlash
from pneu_sim.effects.base import POSITION, Effect, EffectParameter
from pneu_sim.effects.blockage import Blockage
from pneu_sim.effects.centre_of_mass import CentreOfMass
from pneu_sim.effects.chamber_compliance import ChamberCompliance
from pneu_sim.effects.chamber_convection import ChamberConvection
from pneu_sim.effects.chamber_heat import ChamberHeat
from pneu_sim.effects.chamber_leak import ChamberLeak
from pneu_sim.effects.chamber_porous_leak import ChamberPorousLeak
from pneu_sim.effects.chamber_relief_valve import ChamberReliefValve
from pneu_sim.effects.chamber_volume import ChamberVolume
from pneu_sim.effects.clock_offset import ClockOffset
from pneu_sim.effects.closing_delay import ClosingDelay
from pneu_sim.effects.common_clock_offset import CommonClockOffset
from pneu_sim.effects.crank_error import CrankError
from pneu_sim.effects.critical_ratio import CriticalRatio
from pneu_sim.effects.cylinder_heat import CylinderHeat
from pneu_sim.effects.cylinder_volume import CylinderVolume
from pneu_sim.effects.dead_band import DeadBand
from pneu_sim.effects.dead_volume import DeadVolume
from pneu_sim.effects.encoder_bias import EncoderBias
from pneu_sim.effects.encoder_gain import EncoderGain
from pneu_sim.effects.encoder_lag import EncoderLag
from pneu_sim.effects.end_cushion import EndCushion
from pneu_sim.effects.external_spring import ExternalSpring
from pneu_sim.effects.fill_exhaust_asymmetry import FillExhaustAsymmetry
from pneu_sim.effects.flow_gain import FlowGain
from pneu_sim.effects.hysteresis import Hysteresis
from pneu_sim.effects.joint_damping import JointDamping
from pneu_sim.effects.joint_friction import JointFriction
from pneu_sim.effects.junction_loss import JunctionLoss
from pneu_sim.effects.laminar_friction import LaminarFriction
from pneu_sim.effects.leak import Leak
from pneu_sim.effects.length_error import LengthError
from pneu_sim.effects.local_loss import LocalLoss
from pneu_sim.effects.null_offset import NullOffset
from pneu_sim.effects.payload import Payload
from pneu_sim.effects.piston_damping import PistonDamping
from pneu_sim.effects.piston_friction import PistonFriction
from pneu_sim.effects.piston_leak import PistonLeak
from pneu_sim.effects.piston_stiction import PistonStiction
from pneu_sim.effects.porous_leak import PorousLeak
from pneu_sim.effects.regulator_droop import RegulatorDroop
from pneu_sim.effects.relief_valve import ReliefValve
from pneu_sim.effects.rod_leak import RodLeak
from pneu_sim.effects.roughness import Roughness
from pneu_sim.effects.seal_friction import SealFriction
from pneu_sim.effects.sensor_bias import SensorBias
from pneu_sim.effects.sensor_gain import SensorGain
from pneu_sim.effects.sensor_lag import SensorLag
from pneu_sim.effects.spool_acceleration_limit import SpoolAccelerationLimit
from pneu_sim.effects.spool_bandwidth import SpoolBandwidth
from pneu_sim.effects.spool_leakage import SpoolLeakage
from pneu_sim.effects.spool_speed_limit import SpoolSpeedLimit
from pneu_sim.effects.supply_level import SupplyLevel
from pneu_sim.effects.supply_ripple import SupplyRipple
from pneu_sim.effects.supply_temperature import SupplyTemperature
from pneu_sim.effects.turbulent_friction import TurbulentFriction
from pneu_sim.effects.unsteady_friction import UnsteadyFriction
from pneu_sim.effects.valve_delay import ValveDelay
from pneu_sim.effects.wall_compliance import WallCompliance
from pneu_sim.effects.wall_heat import WallHeat
from pneu_sim.rig.model import Model
from pneu_sim.rig.schema import AttachedEffect, Rig

BUILT_IN: tuple[type[Effect], ...] = (
    SensorBias,
    SensorGain,
    ClockOffset,
    SensorLag,
    ValveDelay,
    ClosingDelay,
    CommonClockOffset,
    SpoolBandwidth,
    SpoolSpeedLimit,
    SpoolAccelerationLimit,
    DeadBand,
    Hysteresis,
    NullOffset,
    FlowGain,
    CriticalRatio,
    FillExhaustAsymmetry,
    SpoolLeakage,
    Leak,
    PorousLeak,
    ReliefValve,
    Blockage,
    LocalLoss,
    JunctionLoss,
    LaminarFriction,
    TurbulentFriction,
    Roughness,
    UnsteadyFriction,
    WallHeat,
    DeadVolume,
    WallCompliance,
    LengthError,
    AreaError,
    ChamberLeak,
    ChamberPorousLeak,
    ChamberReliefValve,
    ChamberVolume,
    ChamberCompliance,
    ChamberHeat,
    ChamberConvection,
    RegulatorDroop,
    SupplyLevel,
    SupplyTemperature,
    SupplyRipple,
    AmbientTemperature,
    AmbientPressure,
    PistonFriction,
    PistonStiction,
    SealFriction,
    PistonDamping,
    PistonLeak,
    RodLeak,
    CylinderVolume,
    CylinderHeat,
    EndCushion,
    JointFriction,
    JointDamping,
    Payload,
    CentreOfMass,
    ExternalSpring,
    Backlash,
    CrankError,
    EncoderBias,
    EncoderGain,
    EncoderLag,
)
"""One line per effect."""

ENTRY_POINT_GROUP = "pneu.effects"

_loaded: dict[str, Effect] = {}


def registry() -> dict[str, Effect]:
    """Every known effect by name."""
    if not _loaded:
        for kind in BUILT_IN:
            _loaded[kind.name] = kind()
        for point in entry_points(group=ENTRY_POINT_GROUP):
            _add(point.load(), f"entry point {point.value}")
    return dict(_loaded)


def load_effect_file(path: str | Path) -> list[str]:
    """Adds the effects defined in a Python file to the registry.

    Args:
        path: A file that defines subclasses of ``Effect``.

    Returns:
        Names of the effects found.

    Raises:
        InputError: The file is missing, does not run, or defines no effect or an incomplete one.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such effects file")
    spec = importlib.util.spec_from_file_location(f"pneu_user_effects_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise InputError(f"{path}: an effects file is Python and ends in .py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:  # whatever the file raises is the user's to read
        message = " ".join(f"{type(error).__name__}: {error}".split())
        raise InputError(f"{path}: {message}") from error
    registry()
    kinds = [
        value
        for value in vars(module).values()
        if isinstance(value, type)
        and issubclass(value, Effect)
        and value.__module__ == spec.name
        and not value.__name__.startswith("_")
    ]
    if not kinds:
        raise InputError(f"{path}: defines no subclass of pneu_sim.effects.Effect")
    for kind in kinds:
        _check(kind, str(path))
    for kind in kinds:
        _add(kind, str(path))
    return [kind.name for kind in kinds]


def _check(kind: type[Effect], origin: str) -> None:
    """Raises InputError where a class does not declare all that an effect declares."""
    where = f"{origin}: effect class {kind.__name__}"
    for field in ("name", "title", "formula", "source", "next_experiment"):
        text = getattr(kind, field, None)
        if not isinstance(text, str) or not text.strip():
            raise InputError(f"{where}: attribute {field!r} is missing; it is a sentence or a name")
    missing = sorted(getattr(kind, "__abstractmethods__", ()))
    if missing:
        raise InputError(f"{where}: method {missing[0]!r} is missing")
    if any(kind.name == known.name for known in BUILT_IN):
        raise InputError(f"{where}: the name {kind.name!r} is taken by a built-in effect")
    parameters = getattr(kind, "parameters", ())
    if not parameters or not all(isinstance(p, EffectParameter) for p in parameters):
        raise InputError(f"{where}: 'parameters' must hold one or more EffectParameter")
    for p in parameters:
        if not (p.lower <= p.absent <= p.upper and p.lower <= p.typical <= p.upper and p.step > 0):
            raise InputError(
                f"{where}: parameter {p.name!r} needs step > 0, lower <= absent <= upper and"
                " lower <= typical <= upper"
            )


def _add(kind: type[Effect], origin: str) -> None:
    _check(kind, origin)
    effect = kind()
    if kind not in BUILT_IN:
        for method in ("places", "limits", "on_rig", "on_model"):
            setattr(effect, method, _told(getattr(effect, method), origin, kind.name))
    _loaded[kind.name] = effect


def _told(method: Callable[..., Any], origin: str, name: str) -> Callable[..., Any]:
    """A method of a user's own effect; what it raises is the user's to read."""

    @functools.wraps(method)
    def call(*arguments: Any, **named: Any) -> Any:
        try:
            return method(*arguments, **named)
        except InputError:
            raise
        except Exception as error:
            message = " ".join(f"{type(error).__name__}: {error}".split())
            raise InputError(
                f"{origin}: effect {name!r}: {method.__name__} does not run ({message})"
            ) from error

    return call


def find_effect(name: str) -> Effect:
    """Returns an effect by name.

    Args:
        name: As listed by ``pneu effects``.

    Raises:
        InputError: There is none of that name.
    """
    effects = registry()
    if name not in effects:
        raise InputError(f"effect {name!r} is unknown; known are {', '.join(sorted(effects))}")
    return effects[name]


def _values(effect: Effect, attached: AttachedEffect, rig: Rig) -> dict[str, float]:
    """All parameters of an attached effect, those that are not given at their usual value."""
    given = attached.parameters
    unknown = set(given) - {p.name for p in effect.parameters}
    if unknown:
        raise InputError(
            f"effect {effect.name!r}: unknown parameter {sorted(unknown)[0]!r}; known are"
            f" {', '.join(p.name for p in effect.parameters)}"
        )
    values = {}
    for p in effect.parameters:
        if p.name == POSITION and p.name not in given:
            raise InputError(
                f"effect {effect.name!r} on {attached.place!r}: parameter {POSITION!r} is missing;"
                " it says where along the pipe the effect sits"
            )
        value = given.get(p.name, p.absent)
        lower, upper = effect.limits(p, rig, attached.place)
        if (
            not lower - p.step <= value <= upper + p.step
        ):  # a difference step may reach past a bound
            raise InputError(
                f"effect {effect.name!r} on {attached.place!r}: {p.name}: found {value:g},"
                f" allowed is {lower:g} to {upper:g} {p.unit}"
            )
        values[p.name] = min(max(value, lower), upper)
    return values


def _in_turn(rig: Rig) -> list[AttachedEffect]:
    """The attached effects as they are applied."""
    return sorted(rig.effects, key=lambda one: find_effect(one.effect).stage)


def apply_to_rig(rig: Rig) -> Rig:
    """Returns the rig with its attached effects worked into its parts.

    Args:
        rig: The rig; left as it is.

    Raises:
        InputError: An attached effect, its place or its parameters are unknown.
    """
    if not rig.effects:
        return rig
    copy = rig.model_copy(deep=True)
    for attached in _in_turn(rig):
        effect = find_effect(attached.effect)
        if effect.is_omitted(rig):
            raise InputError(
                f"effect {effect.name!r} on {attached.place!r}: model {rig.model!r} of rig"
                f" {rig.name!r} has nothing of it; take it off, or use model 'pde'"
            )
        places = effect.places(rig)
        if attached.place not in places:
            raise InputError(
                f"effect {effect.name!r}: place {attached.place!r} is not one of"
                f" {', '.join(places) or 'this rig (it has none)'}"
            )
        effect.on_rig(copy, attached.place, _values(effect, attached, rig))
    return copy


def apply_to_model(rig: Rig, model: Model) -> None:
    """Lets the attached effects change a built model in place.

    Args:
        rig: The rig.
        model: The model built from it.
    """
    for attached in _in_turn(rig):
        effect = find_effect(attached.effect)
        # Checked by apply_to_rig, against lengths that effects may have changed since.
        values = {p.name: attached.parameters.get(p.name, p.absent) for p in effect.parameters}
        effect.on_model(model, rig, attached.place, values)
