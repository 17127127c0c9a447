# SPDX-License-Identifier: Apache-2.0
"""In which ways a rig file may be wrong: sizes in other units, wiring, taps in other places."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

from pneu_sim.rig.parameters import get_parameter, with_parameters
from pneu_sim.rig.plausible import RANGES
from pneu_sim.rig.schema import CLOSED, Rig
from pneu_sim.signals import Signal
from pneu_sysid.records import Recording

NEAR_M = 0.3
"""A tap of a chamber is not told from one so near on a pipe to it."""
SHORTEST_M = 0.05
"""No pipe is tried that is shorter: its cells would need very many steps."""


@dataclass(frozen=True, eq=False)
class Guess:
    """One way in which the file may be wrong: the rig and the recordings as they would be then.

    Attributes:
        kind: ``size``, ``wiring`` or ``tap``; ``none`` is the file as it is.
        what: Path of the part.
        words: What is said of it; of sizes that is worked out once one fits.
        rig: The rig as it would be.
        recordings: The recordings as they would be.
        own_grid: Whether it has cells or recordings of its own, so that it shares no batch.
        paths: Of a size, the numbers that change together.
        decades: Of a size, by how many powers of ten.
    """

    kind: str
    what: str
    words: str
    rig: Rig
    recordings: list[Recording]
    own_grid: bool = True
    paths: tuple[str, ...] = ()
    decades: float = 0.0


def sizes(rig: Rig) -> list[tuple[str, tuple[str, ...]]]:
    """What may be given in another unit: its name, and the paths that share it.

    Args:
        rig: The rig.
    """
    out: list[tuple[str, tuple[str, ...]]] = []
    for v, valve in rig.valves.items():
        paths = tuple(
            f"valves.{v}.ports.{p}."
            + ("conductance_m3_s_pa" if port.model == "iso6358" else "area_m2")
            for p, port in valve.ports.items()
        )
        if len(paths) > 1:
            out.append((f"valves.{v}.ports", paths))
        out += [(path, (path,)) for path in paths]
        if valve.spool.bandwidth_hz is not None:
            path = f"valves.{v}.spool.bandwidth_hz"
            out.append((path, (path,)))
    singles = [f"orifices.{o}.conductance_m3_s_pa" for o in rig.orifices]
    singles += [f"chambers.{c}.volume_m3" for c in rig.chambers]
    for p in rig.pipes:
        singles += [f"pipes.{p}.area_m2", f"pipes.{p}.length_m"]
    return out + [(path, (path,)) for path in singles]


def possible(
    rig: Rig, cases: list[tuple[str, tuple[str, ...], float]]
) -> list[tuple[str, tuple[str, ...], float]]:
    """Sizes so changed that are worth a run: very short pipes need very many steps.

    Args:
        rig: The rig.
        cases: Name, paths and powers of ten of each.
    """
    out = []
    for what, paths, decades in cases:
        known = RANGES[paths[0].rpartition(".")[2]]
        value = get_parameter(rig, paths[0]) * 10.0**decades
        least = max(known.low, SHORTEST_M) if paths[0].endswith("length_m") else known.low
        if least <= value <= known.high:
            out.append((what, paths, decades))
    return out


def resized(base: Guess, what: str, paths: tuple[str, ...], decades: float) -> Guess:
    """The guess that a size is given in another unit; taps stay within pipes that get shorter.

    Args:
        base: The file as it is.
        what: Name of the size.
        paths: The numbers that share it.
        decades: Powers of ten by which they change.
    """
    rig = with_parameters(
        base.rig, {path: get_parameter(base.rig, path) * 10.0**decades for path in paths}
    )
    length = paths[0].endswith("length_m")
    if length:
        pipe = paths[0].split(".")[1]
        for name, tap in rig.taps.items():
            if tap.pipe == pipe:
                position = min(tap.position_m, rig.pipes[pipe].length_m)
                rig.taps[name] = tap.model_copy(update={"position_m": position})
    return Guess("size", what, "", rig, base.recordings, length, paths, decades)


def wirings(base: Guess) -> list[Guess]:
    """Valves with their ends exchanged, and pairs of valves with each other's commands.

    Args:
        base: The file as it is.
    """
    rig, out = base.rig, []

    def commanded(what: str, words: str, change: Callable[[Recording], dict[str, Signal]]) -> None:
        recordings = [replace(r, commands={**r.commands, **change(r)}) for r in base.recordings]
        out.append(Guess("wiring", what, words, rig, recordings))

    for v, valve in rig.valves.items():
        name, null = valve.command, valve.spool.null_v

        def mirrored(r: Recording, name: str = name, null: float = null) -> dict[str, Signal]:
            signal = r.commands[name]
            return {name: Signal(signal.time_s, 2.0 * null - signal.values)}

        commanded(
            f"valves.{v}",
            f"the pressures rise where they should fall; either its ports"
            f" ({', '.join(valve.ports)}) are exchanged, or its command {name!r} is mirrored about"
            f" {null:g} V",
            mirrored,
        )
    for (v, one), (w, two) in combinations(rig.valves.items(), 2):
        a, b = one.command, two.command
        if a == b:
            continue

        def exchanged(r: Recording, a: str = a, b: str = b) -> dict[str, Signal]:
            return {a: r.commands[b], b: r.commands[a]}

        commanded(
            f"valves.{v}.command",
            f"the valves {v!r} and {w!r} follow each other's commands: {a!r} and {b!r} seem to be"
            " exchanged, in the file or in their channels",
            exchanged,
        )
    return out


def _places(rig: Rig) -> dict[str, dict[str, Any]]:
    """Where else a tap may sit: chambers, and the ends of pipes, one of each node."""
    out: dict[str, dict[str, Any]] = {
        f"chamber {name!r}": {"chamber": name, "pipe": None, "position_m": 0.0}
        for name in rig.chambers
    }
    nodes = set(rig.chambers)
    for name, pipe in rig.pipes.items():
        for node, x in ((pipe.from_node, 0.0), (pipe.to_node, pipe.length_m)):
            if node in nodes:
                continue
            if node != CLOSED:
                nodes.add(node)
            side = "from" if x == 0.0 else "to"
            place = {"pipe": name, "position_m": x, "chamber": None}
            out[f"the {side!r} end of pipe {name!r}"] = place
    return out


def moved_taps(base: Guess) -> list[Guess]:
    """Pairs of taps in each other's places, and taps in places of other volumes and pipes.

    Args:
        base: The file as it is.
    """
    rig, out = base.rig, []

    def placed(places: dict[str, dict[str, Any]]) -> Rig:
        taps = {name: tap.model_copy(update=places.get(name, {})) for name, tap in rig.taps.items()}
        return rig.model_copy(update={"taps": taps})

    own = {
        name: {"pipe": t.pipe, "position_m": t.position_m, "chamber": t.chamber}
        for name, t in rig.taps.items()
    }
    for a, b in combinations(rig.taps, 2):
        words = (
            f"the readings of {a!r} and {b!r} fit each other's places; their channels, or their"
            " places in the file, seem to be exchanged"
        )
        out.append(
            Guess("tap", f"taps.{a}", words, placed({a: own[b], b: own[a]}), base.recordings)
        )
    for name, tap in rig.taps.items():
        for words, place in _places(rig).items():
            if place["pipe"] is not None and place["pipe"] == tap.pipe:
                apart = abs(place["position_m"] - tap.position_m)
                if apart < 0.5 * rig.pipes[place["pipe"]].length_m:
                    continue
            if place["chamber"] is not None and place["chamber"] == tap.chamber:
                continue
            if tap.chamber is not None and place["pipe"] is not None:
                pipe = rig.pipes[place["pipe"]]
                if tap.chamber in (pipe.from_node, pipe.to_node) and pipe.length_m < NEAR_M:
                    continue
            where = f"pipe {tap.pipe!r}" if tap.pipe is not None else f"chamber {tap.chamber!r}"
            text = f"its readings are not those of {where}, but fit {words}"
            out.append(Guess("tap", f"taps.{name}", text, placed({name: place}), base.recordings))
    return out
