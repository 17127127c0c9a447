# SPDX-License-Identifier: Apache-2.0
"""A learned controller as one small file: weights, recipe of its features, rig and training.

An .npz archive without pickles: per layer ``weight_<n>`` (outputs, inputs) and ``bias_<n>``, the
logarithm ``log_std`` of the deviation it was trained with, and ``about``, the rest as JSON. The
same policy has the same bytes. It is run with numpy alone: tanh between the layers, the last is
linear.
"""

import hashlib
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.files import whole
from pneu_policy.control.observations import Recipe
from pneu_sim.rig.schema import Rig

VERSION = 1
LARGEST_BYTES = 64 * 2**20
"""No array of a policy is larger; a file that says otherwise is refused before it is unpacked."""

Single = NDArray[np.float32]
Floats = NDArray[np.float64]


def rig_identity(rig: Rig) -> dict[str, Any]:
    """What a rig must have in common with the one a policy was trained for.

    Valve commands, the pipe of each tap and the lengths of pipes; not what a calibration finds,
    such as areas, friction, or the exact places of taps, and not how the gas is modelled.

    Args:
        rig: The rig.

    Returns:
        ``name``, ``commands``, ``taps`` (name to pipe or chamber), ``pipes`` (name to length, m, to
        the millimetre) and ``sha256`` of the latter three.
    """
    matters: dict[str, Any] = {
        "commands": sorted(rig.commands),
        "taps": {name: tap.pipe or tap.chamber for name, tap in sorted(rig.taps.items())},
        "pipes": {name: round(pipe.length_m, 3) for name, pipe in sorted(rig.pipes.items())},
    }
    return {"name": rig.name, **matters, "sha256": _digest(matters)}


def _digest(matters: Mapping[str, Any]) -> str:
    text = json.dumps({k: matters[k] for k in ("commands", "taps", "pipes")}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class PolicyFile:
    """A learned controller and where it comes from.

    Attributes:
        weights: Per layer the (outputs, inputs) matrix and the (outputs,) bias; tanh between, the
            last layer is linear and has one output, the action.
        recipe: How its features are made.
        rig: What it was trained for, from `rig_identity`.
        training: How it was trained: algorithm, seed, iterations, samples, model, rig file and its
            digest, score, rmse_pa, versions, settings; plain data.
        log_std: Logarithm of the standard deviation of the actions in training.
        path: File that it was read from.
    """

    weights: list[tuple[Single, Single]]
    recipe: Recipe
    rig: dict[str, Any]
    training: dict[str, Any]
    log_std: float = 0.0
    path: Path | None = None
    _layers: list[tuple[Floats, Floats, Floats]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Raises InputError where the parts do not fit together."""
        width = self.recipe.size
        layers = []
        for n, (weight, bias) in enumerate(self.weights):
            if weight.ndim != 2 or weight.shape[1] != width or bias.shape != weight.shape[:1]:
                raise InputError(
                    f"layer {n}: found weights of shape {weight.shape} and biases of"
                    f" {bias.shape}, needed are {width} inputs and one bias per output"
                )
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise InputError(f"layer {n}: found a weight that is not finite")
            width = weight.shape[0]
            # Double precision costs nothing at this size; the sums differ less between machines.
            layers.append((weight.astype(np.float64), bias.astype(np.float64), np.empty(width)))
        if not layers or width != 1:
            raise InputError(f"weights: found {width} outputs of the last layer, needed is 1")
        if not np.isfinite(self.log_std):
            raise InputError(f"log_std: found {self.log_std}, it must be finite")
        try:
            true = _digest(self.rig)
            taps, name = self.rig["taps"], self.rig["name"]
        except (KeyError, TypeError):
            raise InputError("rig: found none that names commands, taps and pipes") from None
        if self.rig.get("sha256") != true:
            raise InputError(f"rig: the digest of rig {name!r} does not belong to it")
        for tap in self.recipe.taps:
            if tap not in taps:
                raise InputError(f"taps: found {tap!r}, rig {name!r} has {', '.join(taps)}")
        object.__setattr__(self, "_layers", layers)

    def act(self, features: Floats) -> float:
        """Action for some features, without exploration.

        Args:
            features: (size,) features, as an `Observer` of the recipe makes them.
        """
        value = features
        last = len(self._layers) - 1
        for n, (weight, bias, out) in enumerate(self._layers):
            np.dot(weight, value, out=out)
            np.add(out, bias, out=out)
            if n < last:
                np.tanh(out, out=out)
            value = out
        return float(value[0])

    def check_rig(self, rig: Rig) -> None:
        """Refuses a rig that the policy was not trained for.

        Args:
            rig: The rig it shall run on.

        Raises:
            InputError: It has other commands, taps or pipes.
        """
        found = rig_identity(rig)
        if found["sha256"] == self.rig["sha256"]:
            return
        raise InputError(
            f"{self.path or 'policy'}: trained for rig {self.rig['name']!r}, found rig"
            f" {rig.name!r}: {_difference(self.rig, found)}"
        )

    def save(self, path: str | Path) -> None:
        """Writes the file, whole or not at all.

        Args:
            path: Where; its folder must exist.

        Raises:
            InputError: It cannot be written.
        """
        about = {
            "pneu_policy": VERSION,
            "recipe": self.recipe.plain(),
            "rig": self.rig,
            "training": self.training,
        }
        try:
            text = json.dumps(about, sort_keys=True, allow_nan=False).encode()
        except (TypeError, ValueError) as error:
            raise InputError(f"training: cannot be written as JSON ({error})") from None
        arrays: dict[str, NDArray[Any]] = {"about": np.frombuffer(text, dtype=np.uint8)}
        for n, (weight, bias) in enumerate(self.weights):
            arrays[f"weight_{n}"] = np.ascontiguousarray(weight, dtype="<f4")
            arrays[f"bias_{n}"] = np.ascontiguousarray(bias, dtype="<f4")
        arrays["log_std"] = np.array(self.log_std, dtype="<f8")
        path = Path(path)
        with whole(path) as aside, zipfile.ZipFile(aside, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, array in arrays.items():
                held = io.BytesIO()
                np.lib.format.write_array(held, array, version=(1, 0), allow_pickle=False)
                # A fixed date, so that the same policy has the same bytes.
                entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, held.getvalue())

    @classmethod
    def load(cls, path: str | Path) -> "PolicyFile":
        """Reads and checks a file.

        Args:
            path: The file.

        Raises:
            InputError: It is missing, damaged, or no policy.
        """
        path = Path(path)
        arrays = _arrays(path)
        try:
            about = json.loads(arrays["about"].tobytes())
            if about["pneu_policy"] != VERSION:
                raise InputError(
                    f"pneu_policy: found {about['pneu_policy']!r}, this version reads {VERSION}"
                )
            layers = sum(name.startswith("weight_") for name in arrays)
            weights = [
                (
                    arrays[f"weight_{n}"].astype(np.float32),
                    arrays[f"bias_{n}"].astype(np.float32),
                )
                for n in range(layers)
            ]
            recipe, rig, training = about["recipe"], about["rig"], about["training"]
            log_std = float(arrays["log_std"])
        except InputError as error:  # first, because it is a ValueError
            raise InputError(f"{path}: {error}") from None
        except (KeyError, TypeError, ValueError) as error:
            what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error
            raise InputError(f"{path}: is no policy file ({what})") from None
        if not (isinstance(recipe, dict) and isinstance(rig, dict) and isinstance(training, dict)):
            raise InputError(f"{path}: is no policy file (recipe, rig and training are mappings)")
        try:
            return cls(weights, Recipe(**recipe), rig, training, log_std, path)
        except (InputError, OverflowError) as error:  # a recipe with an infinite whole number
            raise InputError(f"{path}: {error}") from None


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an archive; reading an entry checks its sum."""
    found = {}
    try:
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                if entry.file_size > LARGEST_BYTES:
                    raise InputError(f"{path}: {entry.filename} is too large for a policy")
                content = io.BytesIO(archive.read(entry))
                array = np.lib.format.read_array(content, allow_pickle=False)
                found[entry.filename.removesuffix(".npy")] = array
    except FileNotFoundError:
        raise InputError(f"{path}: no such policy file") from None
    except (
        OSError,
        EOFError,
        MemoryError,
        ValueError,
        RuntimeError,  # also what is not implemented: a flag that was flipped
        struct.error,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise InputError(f"{path}: is no policy file, or a damaged one ({error})") from None
    return found


def _difference(trained: Mapping[str, Any], found: Mapping[str, Any]) -> str:
    """The first thing in which two rigs differ, in words."""
    for what, one in (("commands", "command"), ("taps", "tap"), ("pipes", "pipe")):
        before, now = trained[what], found[what]
        missing = [name for name in before if name not in now]
        if missing:
            return f"it has no {one} {missing[0]!r} ({', '.join(now)})"
        more = [name for name in now if name not in before]
        if more:
            return f"its {one} {more[0]!r} was not there"
        for name in before:
            if what == "taps" and before[name] != now[name]:
                return f"tap {name!r} is on {now[name]!r}, not on {before[name]!r}"
            if what == "pipes" and before[name] != now[name]:
                return f"pipe {name!r} is {now[name]:g} m long, not {before[name]:g} m"
    return "they differ in their digests"
