# SPDX-License-Identifier: Apache-2.0
"""What a plant has that its hand file does not tell: other values of the MJCF, sensors that lie.

It changes the MJCF itself, by MuJoCo's own names, and knows nothing of the effects by which it is
to be found.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.validation import Listed, Settings, sentence

ATTRIBUTES = {
    "geom": ("friction", "mass", "stiffness", "damping", "size"),
    "joint": ("stiffness", "damping", "frictionloss", "armature"),
    "tendon": ("stiffness", "damping"),
}
"""What may be other of each element. Of a geom, stiffness and damping are those of its contacts
(``solref`` by two negative numbers), and a size is that of all its sizes."""


class Change(Settings):
    """One value of the MJCF that is another.

    Attributes:
        of: Element.
        name: Its name.
        set: Which value.
        to: What it is.
        times: Instead, what it is multiplied by.
    """

    of: Literal["geom", "joint", "tendon"]
    name: str
    set: str
    to: float | None = None
    times: float | None = None


class Lie(Settings):
    """How a sensor differs from what it should read.

    Attributes:
        gain: Its readings times this.
        bias: Added to all its components.
        lag_s: It reads what was so long ago.
    """

    gain: float = 1.0
    bias: float = 0.0
    lag_s: Annotated[float, Field(ge=0.0, le=0.05)] = 0.0


class Truth(Settings):
    """What is hidden.

    Attributes:
        pneu_truth: Version of this schema.
        model: Values of the MJCF that are others.
        sensors: Sensors that lie, by their names in the MJCF.
    """

    pneu_truth: Literal[1] = 1
    model: Annotated[tuple[Change, ...], Listed] = ()
    sensors: dict[str, Lie] = {}

    def put(self, spec: Any, what: str) -> None:
        """Changes an MJCF.

        Args:
            spec: An ``MjSpec``.
            what: Where this is from, for messages.

        Raises:
            InputError: Something is not there, or is not to be changed.
        """
        known = {s.name for s in spec.sensors}
        for name in self.sensors:
            if name not in known:
                raise InputError(f"{what}: sensors: no sensor {name!r}; there are {_list(known)}")
        for number, change in enumerate(self.model):
            where = f"{what}: model.{number}"
            allowed = ATTRIBUTES[change.of]
            if change.set not in allowed:
                raise InputError(
                    f"{where}.set: found {change.set!r}, of a {change.of} {', '.join(allowed)} are"
                    " allowed"
                )
            if (change.to is None) == (change.times is None):
                raise InputError(f"{where}: either to or times is needed")
            element = getattr(spec, change.of)(change.name)
            if element is None:
                there = {e.name for e in getattr(spec, f"{change.of}s") if e.name}
                raise InputError(
                    f"{where}.name: no {change.of} {change.name!r}; there are {_list(there)}"
                )
            _set(element, change)

    def lines(self) -> list[str]:
        """What is hidden, a line each."""
        out = []
        for change in self.model:
            by = f"= {change.to:g}" if change.to is not None else f"times {change.times:g}"
            out.append(f"{change.set} of {change.of} {change.name} {by}")
        for name, lie in self.sensors.items():
            parts = []
            if lie.gain != 1.0:
                parts.append(f"times {lie.gain:g}")
            if lie.bias:
                parts.append(f"{lie.bias:+g}")
            if lie.lag_s:
                parts.append(f"{1e3 * lie.lag_s:g} ms late")
            out.append(f"sensor {name} {', '.join(parts)}")
        return out


def _list(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "none"


def _set(element: Any, change: Change) -> None:
    if change.of == "geom" and change.set in ("stiffness", "damping"):
        at = ("stiffness", "damping").index(change.set)
        ref = [float(x) for x in element.solref]
        if ref[0] >= 0.0:  # a time constant and a damping ratio (MuJoCo, solver parameters)
            ref = [-1.0 / (ref[0] * ref[1]) ** 2, -2.0 / ref[0]]
        ref[at] = -_new(-ref[at], change)
        element.solref = ref
        return
    if change.set == "size":
        element.size = [_new(float(x), change) for x in element.size]
        return
    value = getattr(element, change.set)
    if hasattr(value, "__len__"):
        values = [float(x) for x in value]
        values[0] = _new(values[0], change)
        setattr(element, change.set, values)
    else:
        setattr(element, change.set, _new(float(value), change))


def _new(before: float, change: Change) -> float:
    return float(change.to) if change.to is not None else before * float(change.times or 0.0)


def checked_truth(data: Any, what: str) -> Truth:
    """A truth as plain values.

    Args:
        data: The values.
        what: Where they are from, for messages.

    Raises:
        InputError: They are none.
    """
    try:
        return Truth.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{what}: {sentence(error, Truth)}") from None


def read_truth(path: str | Path) -> Truth:
    """Reads what is hidden from a YAML file.

    Args:
        path: The file.

    Raises:
        InputError: It is missing or no such file.
    """
    return checked_truth(read_yaml(path, "truth"), str(path))
