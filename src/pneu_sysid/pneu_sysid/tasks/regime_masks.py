# SPDX-License-Identifier: Apache-2.0
"""Which readings belong to which regime of operation, as one file beside the signals."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.files import whole
from pneu_sysid.tasks.signals import readings_in_order

if TYPE_CHECKING:  # whoever looks at signals loads no solver
    from pneu_sysid.problem import Problem
    from pneu_sysid.regimes import Operation

Mask = NDArray[np.bool_]
Key = tuple[str, str, str]
"""Kind of a regime, what it is about, and its label."""

REGIMES = "regimes.npz"
"""Its name in the folder of a model."""
LEFT_OUT = ("time",)
"""Kinds of which there are as many as seconds; time is told by time."""


@dataclass(frozen=True)
class RegimeMasks:
    """Regimes of every sensor.

    Attributes:
        sensors: By sensor and regime (n,) which of its readings belong to it, as its trace has
            them.
    """

    sensors: dict[str, dict[Key, Mask]]

    def of(self, sensor: str, key: Key) -> Mask | None:
        """(n,) which readings of a sensor belong to a regime; None where it has none such.

        Args:
            sensor: Its name.
            key: The regime.
        """
        return self.sensors.get(sensor, {}).get(key)


def regime_masks(problem: Problem, work: Operation) -> RegimeMasks:
    """Regimes of the readings of recordings.

    Args:
        problem: The recordings.
        work: What the rig did along them.
    """
    from pneu_sysid.regimes import FEWEST  # with the solver, which has made the problem

    sensors: dict[str, dict[Key, Mask]] = {}
    for k, name in enumerate(problem.taps):
        there, order, _ = readings_in_order(problem, k)
        sensors[name] = {
            (one.kind, one.of, one.label): one.mask[there][order]
            for one in work.sets(name)
            if one.kind not in LEFT_OUT and int(one.mask.sum()) >= FEWEST
        }
    return RegimeMasks(sensors)


def save_regimes(masks: RegimeMasks, path: Path) -> None:
    """Writes them, whole or not at all.

    Args:
        masks: They.
        path: NumPy archive.
    """
    about: list[dict[str, Any]] = []
    arrays: dict[str, Any] = {}
    for k, (name, regimes) in enumerate(masks.sensors.items()):
        count = next((mask.size for mask in regimes.values()), 0)
        about.append({"sensor": name, "count": count, "regimes": [list(key) for key in regimes]})
        rows = np.array(list(regimes.values()), dtype=bool).reshape(len(regimes), count)
        arrays[f"masks_{k}"] = np.packbits(rows, axis=1)
    arrays["about"] = np.array(json.dumps(about))
    with whole(path) as aside, aside.open("wb") as file:
        np.savez_compressed(file, **arrays)


def load_regimes(path: Path) -> RegimeMasks:
    """Reads them again.

    Args:
        path: NumPy archive that `save_regimes` wrote.

    Raises:
        InputError: It cannot be read, or is another's.
    """
    sensors: dict[str, dict[Key, Mask]] = {}
    try:
        with np.load(path, allow_pickle=False) as file:
            for k, told in enumerate(json.loads(str(file["about"]))):
                rows = np.unpackbits(file[f"masks_{k}"], axis=1, count=int(told["count"]))
                keys: Sequence[Sequence[str]] = told["regimes"]
                sensors[told["sensor"]] = {
                    (str(kind), str(of), str(label)): row.astype(bool)
                    for (kind, of, label), row in zip(keys, rows, strict=True)
                }
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise InputError(f"{path}: holds no regimes ({error})") from None
    return RegimeMasks(sensors)
