# SPDX-License-Identifier: Apache-2.0
"""A network of tanh layers that runs with numpy alone, and the small file that it is kept in.

The file is an .npz archive without pickles: per layer ``weight_<n>`` (outputs, inputs) and
``bias_<n>``, the logarithm ``log_std`` of the deviation it was trained with, and ``about``, the
rest as JSON. The same network has the same bytes.
"""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_common.files import whole

LARGEST_BYTES = 64 * 2**20
"""No array of a policy is larger; a file that says otherwise is refused before it is unpacked."""

Single = NDArray[np.float32]
Floats = NDArray[np.float64]
Layers = Sequence[tuple[Single, Single]]
"""Per layer the (outputs, inputs) matrix and the (outputs,) bias."""


class Network:
    """Layers with tanh between them; the last one is linear."""

    def __init__(self, layers: Layers, inputs: int, outputs: int) -> None:
        """Takes the layers.

        Args:
            layers: They.
            inputs: How many features there are.
            outputs: How many actions.

        Raises:
            InputError: They do not fit together, or hold a number that is not finite.
        """
        width = inputs
        self._layers: list[tuple[Floats, Floats, Floats]] = []
        for n, (weight, bias) in enumerate(layers):
            if weight.ndim != 2 or weight.shape[1] != width or bias.shape != weight.shape[:1]:
                raise InputError(
                    f"layer {n}: found weights of shape {weight.shape} and biases of"
                    f" {bias.shape}, needed are {width} inputs and one bias per output"
                )
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise InputError(f"layer {n}: found a weight that is not finite")
            width = weight.shape[0]
            # Double precision costs nothing at this size; the sums differ less between machines.
            self._layers.append((weight.astype(float), bias.astype(float), np.empty(width)))
        if not self._layers or width != outputs:
            raise InputError(
                f"weights: found {width} outputs of the last layer, needed is {outputs}"
            )

    def act(self, features: Floats) -> Floats:
        """(outputs,) actions, without exploration; written anew at the next call.

        Args:
            features: (inputs,).
        """
        value = features
        last = len(self._layers) - 1
        for n, (weight, bias, out) in enumerate(self._layers):
            np.dot(weight, value, out=out)
            np.add(out, bias, out=out)
            if n < last:
                np.tanh(out, out=out)
            value = out
        return value


def write_weights(
    path: str | Path, layers: Layers, log_std: float, about: Mapping[str, Any]
) -> None:
    """Writes the file, whole or not at all.

    Args:
        path: Where; its folder must exist.
        layers: The network's.
        log_std: Logarithm of the deviation it was trained with.
        about: Plain data.

    Raises:
        InputError: It cannot be written.
    """
    try:
        text = json.dumps(about, sort_keys=True, allow_nan=False).encode()
    except (TypeError, ValueError) as error:
        raise InputError(f"training: cannot be written as JSON ({error})") from None
    arrays: dict[str, NDArray[Any]] = {"about": np.frombuffer(text, dtype=np.uint8)}
    for n, (weight, bias) in enumerate(layers):
        arrays[f"weight_{n}"] = np.ascontiguousarray(weight, dtype="<f4")
        arrays[f"bias_{n}"] = np.ascontiguousarray(bias, dtype="<f4")
    arrays["log_std"] = np.array(log_std, dtype="<f8")
    path = Path(path)
    with whole(path) as aside, zipfile.ZipFile(aside, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            held = io.BytesIO()
            np.lib.format.write_array(held, array, version=(1, 0), allow_pickle=False)
            # A fixed date, so that the same policy has the same bytes.
            entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, held.getvalue())


def read_weights(
    path: Path, key: str, version: int
) -> tuple[list[tuple[Single, Single]], float, dict[str, Any]]:
    """Reads a file.

    Args:
        path: The file.
        key: What ``about`` has the version under, which says what kind of policy it is.
        version: The only one that is read.

    Returns:
        Layers, ``log_std`` and ``about``.

    Raises:
        InputError: It is missing, damaged, or no policy of that kind.
    """
    arrays = _arrays(path)
    try:
        about = json.loads(arrays["about"].tobytes())
        if about[key] != version:
            raise InputError(f"{key}: found {about[key]!r}, this version reads {version}")
        count = sum(name.startswith("weight_") for name in arrays)
        layers = [
            (arrays[f"weight_{n}"].astype(np.float32), arrays[f"bias_{n}"].astype(np.float32))
            for n in range(count)
        ]
        return layers, float(arrays["log_std"]), about
    except InputError as error:  # first, because it is a ValueError
        raise InputError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError) as error:
        what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error
        raise InputError(f"{path}: is no policy file ({what})") from None


def kind_of(path: str | Path) -> str:
    """Which kind of policy a file holds: the key of its version, such as ``pneu_policy``.

    Args:
        path: The file.

    Raises:
        InputError: It is missing, damaged, or no policy.
    """
    path = Path(path)
    try:
        about = json.loads(_arrays(path)["about"].tobytes())
        return next(key for key in about if key.startswith("pneu_"))
    except (KeyError, TypeError, ValueError, StopIteration):
        raise InputError(f"{path}: is no policy file") from None


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
