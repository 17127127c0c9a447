# SPDX-License-Identifier: Apache-2.0
"""What an effect of a scene is: a quantity of the mechanism, its contacts or its sensors.

The same quantity is a parameter where a scene lists it to be fitted, and a candidate where it does
not: what is missing is then what it would have to be instead of what it is.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pneu_sysid.contacts.names import ADDED, AXES

Floats = NDArray[np.float64]

ALL = "all"
"""The place that stands for everything of its kind that touches."""


@dataclass
class Reading:
    """How a sensor tells what MuJoCo's would.

    Attributes:
        gain: What it multiplies by.
        bias: What it adds, per component, in its unit.
        lag_s: How much later it tells it, s.
    """

    gain: float = 1.0
    bias: dict[int, float] = field(default_factory=dict)
    lag_s: float = 0.0


@dataclass
class Setup:
    """A scene as a model is made from it; effects change it.

    Attributes:
        spec: MuJoCo's ``MjSpec``.
        readings: Per sensor that the scene uses.
        widths: How many components each has.
        messages: Sensors that are told in one message, by its topic, where there are several.
        clock: Duration of a second of the recording, s.
        drag: Force against the velocity of the centre of each body that moves freely, N s/m.
        loaded: Friction of joints by what they carry, torque per force, by the joint.
        scaled: What geoms were multiplied by.
        gravity: Gravity of the MJCF, m/s^2.
        heavier: What it was multiplied by.
        lean: Its direction towards x and y, rad.
        tilt: Turn about x and y of all that is fixed, gravity too, rad.
        massive: What bodies' masses were multiplied by.
        shifted: How far bodies' centres of mass were moved, m, by body and axis.
    """

    spec: Any
    readings: dict[str, Reading]
    widths: dict[str, int]
    messages: dict[str, tuple[str, ...]] = field(default_factory=dict)
    clock: float = 1.0
    drag: float = 0.0
    loaded: dict[str, float] = field(default_factory=dict)
    scaled: float = 1.0
    gravity: tuple[float, ...] = ()
    heavier: float = 1.0
    lean: tuple[float, float] = (0.0, 0.0)
    tilt: tuple[float, float] = (0.0, 0.0)
    massive: dict[str, float] = field(default_factory=dict)
    shifted: dict[tuple[str, int], float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Notes what the MJCF has of what effects change."""
        self.gravity = tuple(float(x) for x in self.spec.option.gravity)


class SceneEffect(ABC):
    """One effect: what it is, where it attaches, and how it changes a scene.

    Attributes:
        name: Its name.
        title: What people call it.
        unit: Unit of its value.
        lower: Least value.
        upper: Largest value.
        typical: What a step of a candidate is measured by: a change that one would notice.
        absent: Value at which it vanishes; None for what is always there, such as friction.
        logarithmic: Whether it is estimated by its logarithm: what may be ten times as large.
        in_mjcf: Whether it changes the MJCF, and not only what sensors make of it.
        candidate: Whether it is tried where something is missing.
        adds_joint: Whether it is a joint that the MJCF lacks: where it has a value there is one
            more direction of motion.
        of_contacts: Whether it says how contacts push. Where impacts are faster than sensors,
            contacts that push less leave less that nobody applied: such an effect is found by what
            roll-outs foretell, where a scene has a horizon.
        formula: What it does, in a line.
        source: Where that is from.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    unit: ClassVar[str]
    lower: ClassVar[float]
    upper: ClassVar[float]
    typical: ClassVar[float]
    absent: ClassVar[float | None] = None
    logarithmic: ClassVar[bool] = False
    in_mjcf: ClassVar[bool] = True
    candidate: ClassVar[bool] = True
    adds_joint: ClassVar[bool] = False
    of_contacts: ClassVar[bool] = False
    formula: ClassVar[str]
    source: ClassVar[str]

    @abstractmethod
    def places(self, setup: Setup) -> list[str]:
        """Where it may be in a scene.

        Args:
            setup: The scene.
        """

    def sought(self, setup: Setup) -> list[str]:
        """Where it is tried where something is missing; wherever it may be unless said.

        Args:
            setup: The scene.
        """
        return self.places(setup)

    @abstractmethod
    def value(self, setup: Setup, place: str) -> float:
        """What it is in a scene.

        Args:
            setup: The scene.
            place: Where.
        """

    @abstractmethod
    def put(self, setup: Setup, place: str, value: float) -> None:
        """Changes a scene so that it is something else.

        Args:
            setup: The scene, changed in place.
            place: Where.
            value: What it is to be.
        """

    @property
    def step(self) -> float:
        """Of a finite difference, in its unit, or in that of its logarithm."""
        return 1e-4 if self.logarithmic else 1e-4 * self.typical


def touching(setup: Setup, place: str = ALL) -> list[Any]:
    """The geoms of a scene that may touch something, all or one.

    Args:
        setup: The scene.
        place: `ALL`, or the name of one.
    """
    geoms = [g for g in setup.spec.geoms if g.contype or g.conaffinity]
    return geoms if place == ALL else [g for g in geoms if g.name == place]


def ruling(setup: Setup, place: str) -> list[Any]:
    """Geoms whose contacts are to be changed; one alone then rules those that it has.

    Of two geoms of equal priority MuJoCo takes the larger friction and mixes the rest.

    Args:
        setup: The scene.
        place: `ALL`, or the name of one.
    """
    geoms = touching(setup, place)
    if place != ALL:
        for geom in geoms:
            geom.priority = max(1, geom.priority)
    return geoms


def of_bodies(setup: Setup) -> list[str]:
    """`ALL`, and the names of the moving geoms that may touch, where there are several.

    Args:
        setup: The scene.
    """
    moving = [g.name for g in touching(setup) if g.parent.name != "world" and g.name]
    if not touching(setup):
        return []
    return [ALL, *(moving if len(moving) > 1 else [])]


def hinges(setup: Setup) -> list[str]:
    """Names of the MJCF's joints of one coordinate.

    Args:
        setup: The scene.
    """
    return [
        joint.name
        for joint in setup.spec.joints
        if int(joint.type) >= 2 and joint.name and not joint.name.startswith(ADDED)
    ]


def moving_bodies(setup: Setup) -> list[Any]:
    """The bodies that joints move.

    Args:
        setup: The scene.
    """
    out: list[Any] = []
    for body in setup.spec.bodies:
        at = body
        while at is not None and at.name != "world":
            if len(at.joints):
                out.append(body)
                break
            at = at.parent
    return out


def lean_gravity(setup: Setup) -> None:
    """Makes gravity what a scene has it: its strength, its lean, and the tilt of all that is fixed.

    Args:
        setup: The scene.
    """
    x, y = setup.lean
    lean = Rotation.from_rotvec([0.0, -x, 0.0]) * Rotation.from_rotvec([y, 0.0, 0.0])
    turned = Rotation.from_rotvec([*setup.tilt, 0.0]) * lean
    setup.spec.option.gravity = setup.heavier * turned.apply(setup.gravity)


TILTED = f"{ADDED}tilted"
"""Name of the frame that all that is fixed is in, where it is turned."""


def tilt_world(setup: Setup, tilt: tuple[float, float]) -> None:
    """Turns all that is fixed to the world about its origin, gravity too; not what moves freely.

    Args:
        setup: The scene.
        tilt: Turn about x and y, rad.
    """
    spec = setup.spec
    frame = spec.frame(TILTED)
    if frame is None:
        world = spec.worldbody
        fixed = [
            *world.frames, *world.geoms, *world.sites, *world.cameras, *world.lights,
            *(b for b in world.bodies if not any(int(j.type) == 0 for j in b.joints)),
        ]  # fmt: skip
        frame = world.add_frame(name=TILTED)
        for thing in fixed:
            if thing.frame is None:
                thing.set_frame(frame)
    frame.quat = Rotation.from_rotvec([*tilt, 0.0]).as_quat(scalar_first=True)
    setup.tilt = tilt
    lean_gravity(setup)


def carried(setup: Setup) -> list[Any]:
    """The bodies that move and are carried by another: those without a free joint of their own.

    Args:
        setup: The scene.
    """
    return [
        body
        for body in moving_bodies(setup)
        if body.name and not any(int(joint.type) == 0 for joint in body.joints)
    ]


def components(setup: Setup) -> list[str]:
    """Every component of every sensor that can be biased, as ``sensor`` or ``sensor.x``.

    Args:
        setup: The scene.
    """
    out = []
    for name, width in setup.widths.items():
        if width == 1:
            out.append(name)
        elif width == 3:
            out += [f"{name}.{axis}" for axis in AXES]
    return out


def split(place: str) -> tuple[str, int]:
    """Sensor and component of a place that `components` gave.

    Args:
        place: The place.
    """
    name, _, axis = place.rpartition(".")
    return (name, AXES.index(axis)) if name else (place, 0)


def explicit(setup: Setup, body: Any) -> list[float]:
    """Writes a body's inertia out, where geoms imply it, and returns its centre of mass.

    Args:
        setup: The scene.
        body: A body of its ``MjSpec``.
    """
    if not body.explicitinertial:
        model = setup.spec.copy().compile()
        number = model.body(body.name).id
        body.mass = float(model.body_mass[number])
        body.ipos = model.body_ipos[number]
        body.iquat = model.body_iquat[number]
        body.inertia = model.body_inertia[number]
        body.explicitinertial = True
    return [float(x) for x in body.ipos]
