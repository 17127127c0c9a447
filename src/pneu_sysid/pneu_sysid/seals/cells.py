# SPDX-License-Identifier: Apache-2.0
"""Strokes cut into a few pieces each: what friction laws are fitted to, and who shares what.

Readings a hundredth of a second apart are no independent witnesses: bore and seal repeat themselves
from stroke to stroke, strokes differ as wholes, and so do recordings. Pieces carry the marks by
which `estimate` lets what they share vary together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sysid.seals.reading import DragTest
from pneu_sysid.seals.strokes import Strokes, strokes_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

PIECES = 8
"""Pieces of a stroke, of equal length ..."""
FEWEST_PIECES = 3
"""... and no fewer than this, where there are many strokes."""
MOST_PIECES = 800
"""Pieces in all; where there would be more, strokes are cut less finely, then some are left out."""
EVEN = 0.1
"""Speeds that differ by less than this share, root mean square, are taken to be even."""
COMMON = 0.6
"""Only the way that most strokes have in common is used, where it is this share of all of it."""
FEWEST_READINGS = 3
"""A piece with fewer readings is not used."""
APART_PA = 2e4
"""Strokes of one recording belong to different levels of pressure if so far apart ..."""
APART = 0.1
"""... and by this share of the pressures' span."""
TURNED = 5.0
"""So many standard errors below zero the friction has to be for the position to be turned round."""


@dataclass(frozen=True)
class Level:
    """The strokes of one recording at about one pressure.

    Attributes:
        name: Name of the recording, with the pressure where it has several.
        recording: Name of the recording.
        gauge_pa: Mean gauge pressure of the measured side while it slides, Pa.
        mean_gauge_pa: Mean of both sides, Pa.
        noise_n: White noise of one reading, N.
    """

    name: str
    recording: str
    gauge_pa: float
    mean_gauge_pa: float
    noise_n: float


@dataclass(frozen=True)
class Readings:
    """Sliding readings of all levels, one after another.

    Attributes:
        piece: (m,) piece that each belongs to.
        rest_n: (m,) force beyond gas and spring, N.
        load_n: (m,) force of gas and spring, N.
        pressure_pa: (m,) mean gauge pressure of both sides, Pa.
        speed_m_s: (m,) speed, m/s.
        place: (m,) place along the way, 0 to 1.
    """

    piece: Ints
    rest_n: Floats
    load_n: Floats
    pressure_pa: Floats
    speed_m_s: Floats
    place: Floats


@dataclass(frozen=True)
class Pieces:
    """Pieces of strokes of all levels, one after another.

    Attributes:
        levels: The levels.
        level: (n,) level of each piece.
        stroke: (n,) its stroke, counted through all levels.
        cycle: (n,) its cycle to and fro, counted within the level.
        way: (n,) +1 where the rod is pressed in, -1 where it is drawn out: the sign of friction.
        bin: (n,) place along the stroke, counted.
        place: (n,) the same as a share of the way, from -0.5 to 0.5.
        readings: What they are made of.
        findings: What was found on the way, in words.
    """

    levels: list[Level]
    level: Ints
    stroke: Ints
    cycle: Ints
    way: Floats
    bin: Ints
    place: Floats
    readings: Readings
    findings: list[str]

    def mean(self, values: Floats) -> Floats:
        """Means over the pieces.

        Args:
            values: (m,) values of the readings.

        Returns:
            (n,) means.
        """
        n = self.level.size
        count = np.bincount(self.readings.piece, minlength=n)
        out: Floats = np.bincount(self.readings.piece, values, minlength=n) / count
        return out

    def cycle_friction(self) -> list[Floats]:
        """Half the difference of the force in and out, of every cycle of every level, N.

        Returns:
            Per level (n_cycles,) values; cycles of which one way is missing are left out.
        """
        rest = self.mean(self.readings.rest_n)
        found = []
        for k in range(len(self.levels)):
            of = self.level == k
            halves = []
            for c in np.unique(self.cycle[of]):
                sides = [of & (self.cycle == c) & (self.way == w) for w in (1.0, -1.0)]
                if all(s.any() for s in sides):
                    halves.append(0.5 * (rest[sides[0]].mean() - rest[sides[1]].mean()))
            found.append(np.array(halves))
        return found


def pieces_of(tests: Sequence[DragTest]) -> Pieces:
    """Finds the strokes of drag tests and cuts them.

    Args:
        tests: The tests, of one cylinder.

    Raises:
        InputError: No test has strokes both ways.
    """
    parts: list[Pieces] = []
    findings: list[str] = []
    found = [strokes_of(test) for test in tests]
    total = sum(strokes.extending.size for strokes in found)
    sparse = min(int(np.bincount(strokes.stroke).min()) for strokes in found)
    room = min(MOST_PIECES // total, sparse // (FEWEST_READINGS + 1))
    pieces = int(np.clip(room, FEWEST_PIECES, PIECES))
    share = min(1.0, MOST_PIECES / (pieces * total))
    for test, strokes in zip(tests, found, strict=True):
        for chosen, gauge in _levels(test, strokes):
            both = {bool(strokes.extending[s]) for s in chosen}
            if len(both) < 2:
                findings.append(
                    f"{test.name}: {len(chosen)} stroke(s) at {gauge * 1e-5:.3g} bar go one way"
                    " only and are left out: friction is not to be told from the force's zero"
                )
                continue
            part, told = _cut(test, strokes, _some(chosen, share), gauge, pieces)
            parts.append(part)
            findings += told
    if not parts:
        raise InputError(
            f"{', '.join(test.name for test in tests)}: found strokes one way only; friction is"
            " told from the force's zero by strokes to and fro"
        )
    names = [p.levels[0].recording for p in parts]
    joined = _joined(parts, [names.count(name) > 1 for name in names], findings)
    return _turned(replace(joined, readings=_calmed(joined)))


def _levels(test: DragTest, strokes: Strokes) -> list[tuple[list[int], float]]:
    """Strokes by level of pressure, and the level's gauge pressure."""
    n = strokes.extending.size
    count = np.bincount(strokes.stroke, minlength=n)
    gauge = np.bincount(strokes.stroke, test.gauge_pa[strokes.index], minlength=n) / count
    order = np.argsort(gauge)
    steps = np.diff(gauge[order])
    # Ways in and out differ by what the regulator lets through; levels by more than that.
    ways = [gauge[strokes.extending == w] for w in (True, False)]
    usual = abs(float(np.median(ways[0]) - np.median(ways[1]))) if all(w.size for w in ways) else 0
    limit = max(APART_PA, APART * float(np.ptp(gauge)), 2.0 * usual)
    edges = np.flatnonzero(steps > limit) + 1
    return [(sorted(part.tolist()), float(gauge[part].mean())) for part in np.split(order, edges)]


def _some(strokes: list[int], share: float) -> list[int]:
    """An even choice of cycles, where there are too many."""
    cycles = [strokes[k : k + 2] for k in range(0, len(strokes), 2)]
    count = max(2, int(share * len(cycles)))
    if count >= len(cycles):
        return strokes
    chosen = np.unique(np.linspace(0, len(cycles) - 1, count).astype(int))
    return [s for k in chosen for s in cycles[k]]


def _way(x: Floats, stroke: Ints, chosen: list[int]) -> tuple[float, float]:
    """The way that most strokes go, from which pieces are cut; all of it where they differ much.

    What a stroke goes beyond the others, it alone has seen of the bore, and beside its turn.
    """
    ends = np.array([[x[stroke == s].min(), x[stroke == s].max()] for s in chosen])
    low, high = float(np.quantile(ends[:, 0], 0.8)), float(np.quantile(ends[:, 1], 0.2))
    least, most = float(np.min(ends)), float(np.max(ends))
    return (low, high) if high - low >= COMMON * (most - least) else (least, most)


def _cut(
    test: DragTest, strokes: Strokes, chosen: list[int], gauge: float, pieces: int
) -> tuple[Pieces, list[str]]:
    """Pieces of the strokes of one level, between the same places in all of them."""
    findings = []
    x = test.extension_m[strokes.index]
    # Each way has ends of its own: a stroke begins to count only after its turn, and slows down
    # before the next.
    ways = {
        out: _way(x, strokes.stroke, [s for s in chosen if strokes.extending[s] == out])
        for out in (False, True)
    }
    low, high = min(w[0] for w in ways.values()), max(w[1] for w in ways.values())
    place = (x - low) / (high - low)
    bins = np.clip(np.floor(place * pieces), 0, pieces - 1).astype(np.int64)
    for out, (first, last) in ways.items():
        beyond = (strokes.extending[strokes.stroke] == out) & ((x < first) | (x > last))
        bins[beyond] = -1
    marks: list[tuple[int, int, float, int, float]] = []
    taken, piece = [], []
    spoilt = 0
    for k, s in enumerate(chosen):
        way = -1.0 if strokes.extending[s] else 1.0
        for bin_ in range(pieces):
            part = np.flatnonzero((strokes.stroke == s) & (bins == bin_))
            if part.size < FEWEST_READINGS:
                continue
            rest = test.rest_n[strokes.index[part]]
            middle = np.median(rest)
            wide = 8.0 * max(1.4826 * float(np.median(np.abs(rest - middle))), test.noise_n)
            good = np.abs(rest - middle) <= wide if wide > 0.0 else np.ones(part.size, dtype=bool)
            spoilt += int(np.count_nonzero(~good))
            kept = part[good]
            taken.append(kept)
            piece.append(np.full(kept.size, len(marks)))
            marks.append((k, k // 2, way, bin_, float(np.mean(place[kept])) - 0.5))
    if spoilt:
        findings.append(
            f"{test.name}: {spoilt} reading(s) of the force far off their neighbours are left out"
        )
    of = np.concatenate(taken)
    index = strokes.index[of]
    columns = list(zip(*marks, strict=True))
    level = Level(
        test.name,
        test.name,
        float(test.gauge_pa[index].mean()),
        float(test.mean_gauge_pa[index].mean()),
        test.noise_n,
    )
    readings = Readings(
        np.concatenate(piece),
        test.rest_n[index],
        test.load_n[index],
        test.mean_gauge_pa[index],
        strokes.speed_m_s[of],
        place[of],
    )
    return Pieces(
        [level],
        np.zeros(len(marks), dtype=np.int64),
        np.array(columns[0]),
        np.array(columns[1]),
        np.array(columns[2]),
        np.array(columns[3]),
        np.array(columns[4]),
        readings,
        [],
    ), findings


def _joined(parts: list[Pieces], several: list[bool], findings: list[str]) -> Pieces:
    levels = [
        replace(p.levels[0], name=f"{p.levels[0].name} at {p.levels[0].gauge_pa * 1e-5:.2f} bar")
        if many
        else p.levels[0]
        for p, many in zip(parts, several, strict=True)
    ]
    pieces = np.cumsum([0, *(p.level.size for p in parts)])
    strokes = np.cumsum([0, *(int(p.stroke.max()) + 1 for p in parts)])

    def together(name: str) -> Floats:
        out: Floats = np.concatenate([getattr(p.readings, name) for p in parts])
        return out

    return Pieces(
        levels,
        np.concatenate([np.full(p.level.size, k) for k, p in enumerate(parts)]),
        np.concatenate([p.stroke + n for p, n in zip(parts, strokes[:-1], strict=True)]),
        np.concatenate([p.cycle for p in parts]),
        np.concatenate([p.way for p in parts]),
        np.concatenate([p.bin for p in parts]),
        np.concatenate([p.place for p in parts]),
        Readings(
            np.concatenate([p.readings.piece + n for p, n in zip(parts, pieces[:-1], strict=True)]),
            together("rest_n"),
            together("load_n"),
            together("pressure_pa"),
            together("speed_m_s"),
            together("place"),
        ),
        findings,
    )


def _real(off: Floats, speed: Floats) -> Floats:
    """Differences of speeds, where they are large enough to be believed."""
    even = float(np.sqrt(np.mean(off**2))) < EVEN * float(np.mean(speed))
    return np.zeros(off.size) if even else off


def _calmed(pieces: Pieces) -> Readings:
    """Readings with even speeds where the machine moves evenly: along a way, or at one place.

    What even speeds still differ by is error of the position, or goes with what changes the force
    at that place. Error in what a force is explained by hides the dependence.
    """
    speed = pieces.mean(pieces.readings.speed_m_s)
    drawn = np.zeros(speed.size)
    for k in range(len(pieces.levels)):
        for way in (1.0, -1.0):
            of = np.flatnonzero((pieces.level == k) & (pieces.way == way))
            along = np.zeros(of.size)
            for b in np.unique(pieces.bin[of]):
                at = pieces.bin[of] == b
                along[at] = speed[of][at].mean()
                drawn[of[at]] = _real(speed[of][at] - along[at], along[at])
            drawn[of] += along.mean() + _real(along - along.mean(), along)
    r = pieces.readings
    return replace(r, speed_m_s=r.speed_m_s * (drawn / speed)[r.piece])


def _turned(pieces: Pieces) -> Pieces:
    """The same, with the position turned round where friction would drive the motion."""
    halves = np.concatenate(pieces.cycle_friction())
    if halves.size < 2:
        return pieces
    error = float(np.std(halves, ddof=1)) / np.sqrt(halves.size)
    if float(halves.mean()) >= -TURNED * error or float(np.max(halves)) >= 0.0:
        return pieces
    found = (
        "position: turned: with the rig file's sign friction would drive the motion; the position"
        " is taken to grow as the rod is pressed in"
    )
    return replace(pieces, way=-pieces.way, findings=[*pieces.findings, found])
