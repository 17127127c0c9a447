# SPDX-License-Identifier: Apache-2.0
"""What a report is made of: the results of the four commands, any of which may be missing."""

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from pneu_common.errors import InputError

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

    def taps_of(self, result: Result | None) -> list[str]:
        """Return the taps of one result, or all taps where it does not name its own.

        Args:
            result: The result of one command.
        """
        return list((result or {}).get("taps") or self.taps)

    @property
    def noise_floor_pa(self) -> dict[str, float]:
        """Sensor noise of each tap for which any result knows it."""
        floors: dict[str, float] = {}
        for result in self.present:
            for tap, floor in (result.get("noise_floor_pa") or {}).items():
                if floor:
                    floors.setdefault(tap, floor)
        return floors

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
