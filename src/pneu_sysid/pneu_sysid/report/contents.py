# SPDX-License-Identifier: Apache-2.0
"""What a report is made of: the results of the four commands, any of which may be missing."""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from pneu_common.errors import InputError
from pneu_sysid.sensor_units import Unit, shared, unit_of

Result: TypeAlias = dict[str, Any]
_T = TypeVar("_T", bound=Hashable)


@dataclass(frozen=True)
class Contents:
    """Results to report, in their JSON form with every number finite or None."""

    compare: Result | None = None
    fit: Result | None = None
    diagnose: Result | None = None
    learn: Result | None = None

    @property
    def present(self) -> list[Result]:
        """The results there are, the furthest-reaching first."""
        every = (self.learn, self.diagnose, self.compare, self.fit)
        return [result for result in every if result is not None]

    @property
    def taps(self) -> list[str]:
        """Names of the pressure taps in the order of the first result that has them."""
        return unique(tap for result in self.present for tap in result.get("taps") or [])

    @property
    def encoders(self) -> dict[str, str]:
        """What each encoder reads, in the order of the first result that has them."""
        units: dict[str, str] = {}
        for result in self.present:
            units = {**(result.get("encoders") or {}), **units}
        return units

    @property
    def sensors(self) -> list[str]:
        """Taps, then encoders."""
        return [*self.taps, *self.encoders]

    def sensors_of(self, result: Result | None) -> list[str]:
        """Return taps and encoders of one result, or all where it does not name its own.

        Args:
            result: The result of one command.
        """
        own = [*((result or {}).get("taps") or []), *((result or {}).get("encoders") or {})]
        return own or self.sensors

    @property
    def noise_floor(self) -> dict[str, float]:
        """Noise of each sensor for which any result knows it, in its own unit."""
        floors: dict[str, float] = {}
        for result in self.present:
            for sensor, floor in both(result, "noise_floor").items():
                if floor:
                    floors.setdefault(sensor, floor)
        return floors

    def unit(self, sensor: str) -> Unit:
        """Return the unit of a sensor.

        Args:
            sensor: Its name.
        """
        return unit_of(sensor, self.encoders)

    def headed(self, name: str) -> str:
        """Return a heading with the unit of all sensors, or without where they differ.

        Args:
            name: The heading.
        """
        one = shared(self.encoders, self.sensors)
        return f"{name}, {one.drawn}" if one else name

    def named(self, sensor: str) -> str:
        """Return a sensor's name, with its unit where headings cannot tell it.

        Args:
            sensor: Its name.
        """
        one = shared(self.encoders, self.sensors)
        return sensor if one or not self.sensors else f"{sensor}, {self.unit(sensor).drawn}"

    @property
    def findings(self) -> list[str]:
        """What was found in the recording, each sentence once."""
        return unique(line for result in self.present for line in result.get("findings") or [])

    @property
    def models(self) -> list[Result]:
        """The compared models."""
        return (self.compare or {}).get("models") or []

    def head(self, *keys: str) -> list[str]:
        """Return the distinct texts that the results carry under any of the keys.

        Args:
            keys: Keys at the top of a result.
        """
        texts: list[str] = []
        for result in self.present:
            for key in keys:
                value = result.get(key)
                texts.extend(map(str, value if isinstance(value, list) else [value or ""]))
        return unique(text for text in texts if text)


def read_contents(results: Mapping[str, Mapping[str, Any] | None]) -> Contents:
    """Check the results and return them with NaN and infinities turned to None.

    Args:
        results: Result of each command by its name, or None.

    Returns:
        The contents of the report.

    Raises:
        InputError: There is no result, or one is not of its command and schema version.
    """
    if all(result is None for result in results.values()):
        raise InputError(f"A report needs at least one result of {', '.join(results)}; none given.")
    for command, result in results.items():
        if result is None:
            continue
        wanted = f"pneu.{command}/1"
        found = result.get("schema")
        if found != wanted:
            raise InputError(
                f"The {command} result of the report has schema {found!r}; "
                f"this version of pneu reads {wanted!r}."
            )
    return Contents(**{command: _finite(result) for command, result in results.items()})


def both(result: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Return what a result says per tap and per encoder, each in its own unit.

    Args:
        result: A result, or a part of one.
        key: The key of the encoders; that of the taps ends in ``_pa`` besides.
    """
    return {**(result.get(f"{key}_pa") or {}), **(result.get(key) or {})}


def errors_of(model: Result) -> dict[str, Result]:
    """Return the errors of a model per tap and encoder, under the keys that encoders have.

    Args:
        model: A compared model.
    """
    return {
        sensor: _alike(entry or {})
        | {"worst": [_alike(s) for s in (entry or {}).get("worst") or []]}
        for key in ("taps", "encoders")
        for sensor, entry in (model.get(key) or {}).items()
    }


def regimes_of(model: Result) -> list[Result]:
    """Return the regimes of a model, taps' and encoders', under the keys that encoders have.

    Args:
        model: A compared model.
    """
    return [
        _alike(regime) | {"encoder": str(regime.get("encoder", regime.get("tap")))}
        for key in ("regimes", "encoder_regimes")
        for regime in model.get(key) or []
    ]


def _alike(entry: Result) -> Result:
    return {key.removesuffix("_pa"): value for key, value in entry.items()}


def unique(items: Iterable[_T]) -> list[_T]:
    """Return the items in order, each once.

    Args:
        items: The items.
    """
    return list(dict.fromkeys(items))


def ratio(value: float | None, floor: float | None) -> float | None:
    """Return value / floor, None where either is missing or the floor is zero.

    Args:
        value: A number.
        floor: What it is measured in.
    """
    return None if value is None or not floor else value / floor


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(item) for item in value]
    return value
