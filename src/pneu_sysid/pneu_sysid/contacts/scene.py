# SPDX-License-Identifier: Apache-2.0
"""Scene files: an MJCF, what was measured of it, and what is to be found, as YAML beside it."""

import io
import os
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator
from ruamel.yaml import YAML

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_common.validation import Listed, Settings, sentence
from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.effects import find_scene_effect, scene_effects
from pneu_sysid.contacts.effects.base import Reading, SceneEffect, Setup
from pneu_sysid.contacts.norms import Norm

SCHEMA_VERSION = 1
LEVER_M = 0.1
"""Of a force that is weighed like a moment, where a scene says nothing of forces."""

Positive = Annotated[float, Field(gt=0.0)]
Names = Annotated[tuple[str, ...], Listed]


class NormSettings(Settings):
    """How a residual is weighed: a standard deviation, or a weight; and the norm.

    Attributes:
        std: Standard deviation, in the residual's unit.
        weight: Instead, what squares are multiplied by (thesis table 2.1).
        kind: See `norms.Norm`.
        width: Where another norm than the square leaves it, in the residual's unit; given the
            standard deviation three of them, unless said.
    """

    std: Positive | None = None
    weight: Positive | None = None
    kind: Literal["square", "huber", "barrier"] = "square"
    width: Positive | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.std is None) == (self.weight is None):
            raise ValueError("either std or weight is needed")
        if self.kind != "square" and self.width is None and self.std is None:
            raise ValueError(f"width is needed for the norm {self.kind}")
        return self

    def norm(self) -> Norm:
        """The norm."""
        weight = self.weight if self.weight is not None else 0.5 / (self.std or 1.0) ** 2
        width = self.width if self.width is not None else 3.0 * (self.std or np.inf)
        return Norm(weight, self.kind, width)


class SensorSettings(Settings):
    """A sensor of the MJCF, and where a recording has its readings.

    Attributes:
        columns: Columns of a CSV file, one per component; quaternions scalar first.
        topic: Topic of a bag.
        field: Which part of its messages, such as ``wrench.force``; told by the sensor unless said.
        joint: Name of the joint in a ``JointState``; the sensor's unless said.
        unit: What a unit of the recording is in SI units: 0.001 for millimetres.
        norm: How its residuals are weighed.
        unzeroed: Components of a vector whose zero differs from one recording to the next; it is
            found with each trajectory.
    """

    columns: Names = ()
    topic: str | None = None
    field: str | None = None
    joint: str | None = None
    unit: Positive = 1.0
    norm: NormSettings
    unzeroed: Annotated[tuple[Literal["x", "y", "z"], ...], Listed] = ()

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if not self.columns and self.topic is None:
            raise ValueError("columns of a CSV file or a topic of a bag are needed")
        return self


class ForceSettings(Settings):
    """How forces that nobody applied are weighed at a joint.

    Attributes:
        translation: Of a free joint, N.
        rotation: Of a free or ball joint, N m.
        along: Of a joint of one coordinate, N m or N.
        of_contact: What a model of contacts gets wrong of their forces, as a share of them: where
            bodies touch, the norms' standard deviations are wider by it.
    """

    translation: NormSettings | None = None
    rotation: NormSettings | None = None
    along: NormSettings | None = None
    of_contact: Annotated[float, Field(ge=0.0)] = 0.0


class ControlSettings(Settings):
    """Where a recording has what an actuator was told.

    Attributes:
        column: Column of a CSV file.
        topic: Topic of a bag.
        field: Which part of its messages; ``effort`` of a ``JointState`` unless said.
        joint: Name of the joint in a ``JointState``; the actuator's joint unless said.
        unit: What a unit of the recording is in the actuator's.
    """

    column: str | None = None
    topic: str | None = None
    field: str | None = None
    joint: str | None = None
    unit: float = 1.0


class KnotSettings(Settings):
    """How finely a trajectory is resolved.

    Attributes:
        step_s: Time between knots, at most, s.
        contact_step_s: The same where bodies are near each other; as elsewhere unless said.
        near_m: How near that is, m.
    """

    step_s: Positive = 0.005
    contact_step_s: Positive | None = None
    near_m: Positive = 0.01


class Value(Settings):
    """An effect with a value, and whether it is fitted.

    Attributes:
        effect: Name of the effect.
        at: Its place.
        value: Its value; what the MJCF has where there is none.
        fit: Whether it is estimated.
        lower: Least value of an estimate; the effect's own unless said.
        upper: Largest value of an estimate.
        std: Standard deviation of what is known of it beforehand, about its value.
    """

    effect: str
    at: str
    value: float | None = None
    fit: bool = True
    lower: float | None = None
    upper: float | None = None
    std: Positive | None = None


class AddedJoint(Settings):
    """A joint that the MJCF lacks: a springy tip, a link that bends (thesis 2.5.2).

    Attributes:
        name: Its name.
        body: The body that it lets move against its parent.
        type: ``hinge`` or ``slide``.
        axis: Its axis in the body's frame.
        pos: Where it is in the body's frame, m.
        stiffness: N m/rad or N/m.
        damping: N m s/rad or N s/m.
    """

    name: str
    body: str
    type: Literal["hinge", "slide"] = "hinge"
    axis: Annotated[tuple[float, float, float], Listed]
    pos: Annotated[tuple[float, float, float], Listed] = (0.0, 0.0, 0.0)
    stiffness: Positive
    damping: Annotated[float, Field(ge=0.0)] = 0.0


class Scene(Settings):
    """A scene: an MJCF, its recordings' sensors, and what is to be estimated.

    Attributes:
        pneu_scene: Version of this schema.
        name: Its name.
        description: What it is, for people.
        mjcf: Path of the MJCF, from the scene file.
        rate_hz: Rate of CSV files that have no column ``time_s``.
        knots: How finely trajectories are resolved.
        sensors: By the name of a sensor in the MJCF.
        controls: By the name of an actuator in the MJCF.
        forces: By the name of a joint in the MJCF.
        joints: Joints that the MJCF lacks.
        values: Effects that differ from the MJCF, and those that are fitted.
        segment_s: Length of stretches that a long recording is cut into, where chance is judged, s.
        start_s: How much of a recording a prediction of the rest begins from, s.
        horizon_s: How far ahead models are asked to predict, s, where parameters are to be those
            that predict best; without, they are those of the joint estimate.
        ignore: Effects that are not tried as candidates.
    """

    pneu_scene: Literal[1] = 1
    name: str
    description: str = ""
    mjcf: str
    rate_hz: Positive | None = None
    knots: KnotSettings = KnotSettings()
    sensors: dict[str, SensorSettings]
    controls: dict[str, ControlSettings] = {}
    forces: dict[str, ForceSettings]
    joints: Annotated[tuple[AddedJoint, ...], Listed] = ()
    values: Annotated[tuple[Value, ...], Listed] = ()
    segment_s: Positive = 1.0
    start_s: Positive = 0.1
    horizon_s: Positive | None = None
    ignore: Names = ()

    def with_values(self, values: tuple[Value, ...]) -> "Scene":
        """The same scene with other effects.

        Args:
            values: They.
        """
        return self.model_copy(update={"values": values})


class Loaded:
    """A scene with its MJCF: makes MuJoCo models of any values.

    Attributes:
        scene: The scene.
        mjcf: Path of the MJCF.
        names: Sensors that it uses, in the MJCF's order.
        widths: Components of each.
    """

    def __init__(self, scene: Scene, folder: Path) -> None:
        """Reads the MJCF and checks that the scene is of it.

        Args:
            scene: The scene.
            folder: Where its MJCF's path starts.

        Raises:
            InputError: The MJCF is missing or no model, or lacks what the scene names.
        """
        self.scene = scene
        self.mjcf = folder / scene.mjcf
        self._mujoco = mujoco_module()
        if not self.mjcf.is_file():
            raise InputError(f"{self.mjcf}: no such MJCF")
        try:
            self._spec = self._mujoco.MjSpec.from_file(str(self.mjcf))
            for joint in scene.joints:
                self._add(joint)
            model = self._spec.compile()
        except (ValueError, self._mujoco.FatalError) as error:
            raise InputError(f"{self.mjcf}: no MJCF that MuJoCo takes ({error})") from None
        self._check(model)
        order = [model.sensor(k).name for k in range(model.nsensor)]
        self.names = [name for name in order if name in scene.sensors]
        self.widths = {name: int(model.sensor_dim[model.sensor(name).id]) for name in self.names}
        base = self.setup()
        for value in scene.values:
            effect = find_scene_effect(value.effect)
            places = effect.places(base)
            if value.at not in places:
                raise InputError(
                    f"values: {value.effect}: no place {value.at!r} in {self.mjcf.name}; there"
                    f" {'are ' + ', '.join(places) if places else 'is none'}"
                )
            if effect.adds_joint and value.value is None:
                raise InputError(
                    f"values: {value.effect}@{value.at}: value is missing; where it is 0 there is"
                    f" nothing to fit, {effect.typical:g} {effect.unit} is a usual one"
                )
            if value.value is not None and not effect.lower <= value.value <= effect.upper:
                unit = f" {effect.unit}" if effect.unit else ""
                raise InputError(
                    f"values: {value.effect}@{value.at}: found {value.value:g}, allowed are"
                    f" {effect.lower:g} to {effect.upper:g}{unit}"
                )

    def _add(self, joint: AddedJoint) -> None:
        body = self._spec.body(joint.body)
        if body is None:
            raise InputError(f"joints: {joint.name}: {self.mjcf.name} has no body {joint.body!r}")
        kinds = self._mujoco.mjtJoint
        kind = kinds.mjJNT_HINGE if joint.type == "hinge" else kinds.mjJNT_SLIDE
        body.add_joint(
            name=joint.name,
            type=kind,
            axis=list(joint.axis),
            pos=list(joint.pos),
            stiffness=[joint.stiffness, 0.0, 0.0],
            damping=[joint.damping, 0.0, 0.0],
        )

    def _check(self, model: Any) -> None:
        def names(count: int, of: Any) -> list[str]:
            return [of(k).name for k in range(count)]

        for kind, wanted, known in (
            ("sensor", self.scene.sensors, names(model.nsensor, model.sensor)),
            ("actuator", self.scene.controls, names(model.nu, model.actuator)),
            ("joint", self.scene.forces, names(model.njnt, model.joint)),
        ):
            for name in wanted:
                if name not in known:
                    raise InputError(
                        f"{kind}s: {self.mjcf.name} has no {kind} {name!r}; it has"
                        f" {', '.join(known) or 'none'}"
                    )
        for name in names(model.njnt, model.joint):
            if name not in self.scene.forces:
                raise InputError(
                    f"forces: joint {name!r} of {self.mjcf.name} is missing: how forces that nobody"
                    " applied are weighed there"
                )
        for name, sensor in self.scene.sensors.items():
            width = int(model.sensor_dim[model.sensor(name).id])
            if sensor.columns and len(sensor.columns) != width:
                raise InputError(
                    f"sensors: {name}: has {width} components in {self.mjcf.name}, found"
                    f" {len(sensor.columns)} columns"
                )
            if sensor.unzeroed and width != 3:
                raise InputError(
                    f"sensors: {name}: unzeroed: has {width} components in {self.mjcf.name}; x, y"
                    " and z are of vectors alone"
                )
        if model.njnt == 0:
            raise InputError(f"{self.mjcf}: nothing in it moves: no joint")
        self._check_bodies(model)

    def _check_bodies(self, model: Any) -> None:
        """Refuses a sensor of the pose of what cannot move."""
        kinds = self._mujoco.mjtSensor
        for name in self.scene.sensors:
            sensor = model.sensor(name).id
            if int(model.sensor_type[sensor]) not in (
                kinds.mjSENS_FRAMEPOS,
                kinds.mjSENS_FRAMEQUAT,
            ):
                continue
            thing, of = int(model.sensor_objid[sensor]), int(model.sensor_objtype[sensor])
            objects = self._mujoco.mjtObj
            body = {
                objects.mjOBJ_SITE: lambda k: int(model.site_bodyid[k]),
                objects.mjOBJ_GEOM: lambda k: int(model.geom_bodyid[k]),
            }.get(of, int)(thing)
            if int(model.body_weldid[body]) == 0:
                raise InputError(
                    f"sensors: {name}: body {model.body(body).name!r} of {self.mjcf.name} has no"
                    " joint: what is seen to move needs a <freejoint/>, or joints that carry it"
                )

    def forces_of(self, model: Any, joint: int) -> ForceSettings:
        """How forces that nobody applied are weighed at a joint of a model.

        One that an effect adds is weighed like the strictest of the scene's that slide or turn as
        it does.

        Args:
            model: A model of the scene.
            joint: Number of the joint.
        """
        name = model.joint(joint).name
        if name in self.scene.forces:
            return self.scene.forces[name]
        slides = int(model.jnt_type[joint]) == 2
        known = [norm for norm in self._forces(model) if norm[0] == slides]
        lever = 1.0
        if not known:  # by what a force is worth as a moment, or a moment as a force
            known = self._forces(model)
            lever = LEVER_M if slides else 1.0 / LEVER_M
        _, norm, share = max(known, key=lambda k: k[1].norm().weight)
        at = norm.norm()
        width = at.width / lever if np.isfinite(at.width) else None
        along = NormSettings(weight=at.weight * lever**2, kind=at.kind, width=width)
        return ForceSettings(along=along, of_contact=share)

    def _forces(self, model: Any) -> list[tuple[bool, NormSettings, float]]:
        """Whether a norm is of forces rather than moments, the norm, and the share of contacts."""
        out = []
        for name, force in self.scene.forces.items():
            slides = int(model.jnt_type[model.joint(name).id]) == 2
            for norm, linear in (
                (force.translation, True),
                (force.rotation, False),
                (force.along, slides),
            ):
                if norm is not None:
                    out.append((linear, norm, force.of_contact))
        return out

    def setup(self, values: tuple[Value, ...] = ()) -> Setup:
        """The scene as a model is made from it.

        They act in the catalogue's order, whatever theirs: two joints that are added to one body
        move each other in the order in which they are there.

        Args:
            values: Effects that differ from the MJCF.
        """
        turns = list(scene_effects())
        readings = {name: Reading() for name in self.names}
        setup = Setup(self._spec.copy(), readings, self.widths, self._messages())
        for value in sorted(values, key=lambda one: (turns.index(one.effect), one.at)):
            if value.value is not None:
                find_scene_effect(value.effect).put(setup, value.at, value.value)
        return setup

    def _messages(self) -> dict[str, tuple[str, ...]]:
        """Sensors of each topic that tells of several at once."""
        told: dict[str, list[str]] = {}
        for name in self.names:
            if topic := self.scene.sensors[name].topic:
                told.setdefault(topic, []).append(name)
        return {topic: tuple(names) for topic, names in told.items() if len(names) > 1}

    def candidates(self, setup: Setup) -> list[tuple[SceneEffect, str]]:
        """Every effect and place that the scene has.

        Args:
            setup: The scene.
        """
        from pneu_sysid.contacts.effects import scene_effects

        return [
            (effect, place)
            for effect in scene_effects().values()
            if effect.candidate and effect.name not in self.scene.ignore
            for place in effect.sought(setup)
        ]


def is_scene(path: str | Path) -> bool:
    """Whether a YAML file says that it is a scene.

    Args:
        path: The file.
    """
    try:
        data = read_yaml(path, "scene file")
    except InputError:
        return False
    return isinstance(data, dict) and "pneu_scene" in data


def load_scene(path: str | Path) -> Loaded:
    """Reads and checks a scene file and its MJCF.

    Args:
        path: The YAML file.

    Raises:
        InputError: The file is missing, is not YAML, or says something a scene cannot be.
    """
    path = Path(path)
    data = read_yaml(path, "scene file")
    if not isinstance(data, dict):
        raise InputError(f"{path}: a scene file is a mapping, found {type(data).__name__}")
    if data.get("pneu_scene") != SCHEMA_VERSION:
        raise InputError(
            f"{path}: pneu_scene: found {data.get('pneu_scene')!r}, this version reads"
            f" {SCHEMA_VERSION}"
        )
    try:
        scene = Scene.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{path}: {sentence(error, Scene)}") from None
    try:
        return Loaded(scene, path.parent)
    except InputError as error:
        text = str(error)
        ours = text.startswith(str(path.parent / scene.mjcf))
        raise InputError(text if ours else f"{path}: {text}") from None


def save_scene(loaded: Loaded, values: tuple[Value, ...], path: str | Path) -> None:
    """Writes a scene file with other values, whole or not at all.

    Args:
        loaded: The scene.
        values: Its effects.
        path: Where; its MJCF is named from there.
    """
    path = Path(path)
    mjcf = Path(os.path.relpath(loaded.mjcf.resolve(), path.resolve().parent)).as_posix()
    scene = loaded.scene.model_copy(update={"values": values, "mjcf": mjcf})
    data = scene.model_dump(mode="json", exclude_defaults=True)
    stream = io.StringIO()
    yaml = YAML()
    yaml.indent(mapping=2, sequence=4, offset=2)
    yaml.width = 100
    yaml.dump({"pneu_scene": SCHEMA_VERSION, **data}, stream)
    write_whole(path, stream.getvalue())
