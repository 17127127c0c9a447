# SPDX-License-Identifier: Apache-2.0
"""What a rig must have in common with the one that a policy was trained for."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any

from pneu_common.errors import InputError
from pneu_sim.rig.schema import Rig

OF_LINES = ("commands", "taps", "pipes")
OF_ROBOTS = (*OF_LINES, "cylinders", "encoders")
ONE = {
    "commands": "command",
    "taps": "tap",
    "pipes": "pipe",
    "cylinders": "cylinder",
    "encoders": "encoder",
}


def rig_identity(rig: Rig) -> dict[str, Any]:
    """What matters of a rig whose pressure is controlled.

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
    return {"name": rig.name, **matters, "sha256": digest(matters, OF_LINES)}


def robot_identity(rig: Rig) -> dict[str, Any]:
    """What matters of a rig that moves: the same, its cylinders and its encoders.

    Lengths of pipes are to the decimetre, because what is built differs by centimetres from what is
    told, and a policy that has seen force alone does not mind.

    Args:
        rig: The rig.

    Returns:
        As of `rig_identity`, with ``cylinders`` (name to bore, rod and stroke in mm, or those of a
        rotary actuator) and ``encoders`` (name to joint or cylinder).
    """
    told = rig_identity(rig)
    cylinders = {}
    for name, c in sorted(rig.cylinders.items()):
        if c.rotary is None:
            cylinders[name] = [round(1e3 * of, 1) for of in (c.bore_m or 0.0, c.rod_m, c.stroke)]
        else:
            cylinders[name] = [round(1e6 * c.rotary.displacement_m3_rad, 2), round(c.stroke, 2)]
    matters = {
        "commands": told["commands"],
        "taps": told["taps"],
        "pipes": {name: round(length, 1) for name, length in told["pipes"].items()},
        "cylinders": cylinders,
        "encoders": {
            name: encoder.cylinder or encoder.on(name)
            for name, encoder in sorted(rig.encoders.items())
        },
    }
    return {"name": rig.name, **matters, "sha256": digest(matters, OF_ROBOTS)}


def digest(matters: Mapping[str, Any], keys: Sequence[str]) -> str:
    """SHA-256 of what matters.

    Args:
        matters: It, by key.
        keys: What of it.

    Raises:
        KeyError: It lacks one.
        TypeError: It is no plain data.
    """
    text = json.dumps({k: matters[k] for k in keys}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def check_identity(trained: Mapping[str, Any], keys: Sequence[str], names: Sequence[str]) -> None:
    """Refuses what a policy file tells of its rig where that was damaged.

    Args:
        trained: What it tells.
        keys: What matters of it.
        names: Taps that the policy sees.

    Raises:
        InputError: It is no such thing, or not what its digest is of.
    """
    try:
        true = digest(trained, keys)
        taps, name = trained["taps"], trained["name"]
    except (KeyError, TypeError):
        raise InputError("rig: found none that names commands, taps and pipes") from None
    if trained.get("sha256") != true:
        raise InputError(f"rig: the digest of rig {name!r} does not belong to it")
    for tap in names:
        if tap not in taps:
            raise InputError(f"taps: found {tap!r}, rig {name!r} has {', '.join(taps)}")


def check_same(
    trained: Mapping[str, Any],
    found: Mapping[str, Any],
    keys: Sequence[str],
    who: str,
    how: str = "trained for",
) -> None:
    """Refuses a rig that a policy was not trained for.

    Args:
        trained: What the policy tells of its rig.
        found: What matters of the rig it shall run on.
        keys: What matters.
        who: The policy.
        how: What it is to the rig it tells of.

    Raises:
        InputError: They differ; the message names the first thing.
    """
    if found["sha256"] == trained["sha256"]:
        return
    raise InputError(
        f"{who}: {how} rig {trained['name']!r}, found rig {found['name']!r}:"
        f" {_difference(trained, found, keys)}"
    )


def _difference(trained: Mapping[str, Any], found: Mapping[str, Any], keys: Sequence[str]) -> str:
    """The first thing in which two rigs differ, in words."""
    for what in keys:
        before, now, one = trained[what], found[what], ONE[what]
        missing = [name for name in before if name not in now]
        if missing:
            return f"it has no {one} {missing[0]!r} ({', '.join(now)})"
        more = [name for name in now if name not in before]
        if more:
            return f"its {one} {more[0]!r} was not there"
        for name in before:
            if what == "commands" or before[name] == now[name]:
                continue
            if what == "pipes":
                return f"pipe {name!r} is {now[name]:g} m long, not {before[name]:g} m"
            if what == "cylinders":
                return f"cylinder {name!r} is {_sizes(now[name])}, not {_sizes(before[name])}"
            return f"{one} {name!r} is on {now[name]!r}, not on {before[name]!r}"
    return "they differ in their digests"


def _sizes(of: Sequence[float]) -> str:
    unit = "mm" if len(of) == 3 else "cm3/rad and rad"
    return f"{' x '.join(f'{size:g}' for size in of)} {unit}"
