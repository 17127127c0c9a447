# SPDX-License-Identifier: Apache-2.0
"""One call from a bag or a text file to a recording, each signal at its own times."""

from pathlib import Path

import numpy as np

from pneu_common.errors import InputError
from pneu_sim.channels import Channel, TextFormat
from pneu_sim.signals import Signal
from pneu_sysid.records.bag import read_bag
from pneu_sysid.records.clean import clean, is_regular
from pneu_sysid.records.clock import choose_clock, mend_clock_jumps
from pneu_sysid.records.recording import Finding, Recording, absent, longest
from pneu_sysid.records.stream import GAP_PERIODS, LONGEST_STEP, READ, Stream, median_period_ns
from pneu_sysid.records.text import read_text

MIN_SAMPLES = 20
_MCAP_MAGIC = b"\x89MCAP"
_APART_NS = 3_600_000_000_000  # an hour between two channels: different clocks, not a pause


def read_recording(
    path: str | Path,
    *,
    commands: dict[str, Channel],
    pressures: dict[str, Channel],
    text: TextFormat | None = None,
    rate_hz: float | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
    positions: dict[str, Channel] | None = None,
    encoders: dict[str, Channel] | None = None,
) -> Recording:
    """Read commands and pressures of a recording, each at its own times; nothing is resampled.

    Time 0 is the first reading of any tap from which on every command is known. Readings
    before it are left out, as are those after the end of a command that is sampled at a
    rate. Commands keep their history before time 0, at negative times, because a valve
    answers to it. Times are differences of stamps in ns, so a common offset does not touch
    them. Gaps are readings that are not there.

    Args:
        path: rosbag2 MCAP folder, .mcap file, or text file.
        commands: Held channels by name; may be empty.
        pressures: Pressure channels by tap; at least one of them or of encoders.
        text: Layout of the rows, if the file is text.
        rate_hz: Readings per second of a tap that has more are thinned to this rate, by
            picking the first after each even beat, without a filter; all are kept if not given.
        start_s: Start of the part to keep, in s after the start of the recording.
        end_s: End of the part to keep, in s after the start of the recording.
        positions: Channels of the measured positions of spools, by valve. They are optional: what
            is not there, or of no use, is told in the report. They are not thinned; kept is what
            lies within the readings of the taps.
        encoders: Channels of encoders by name; what is said of taps holds for them.

    Returns:
        The recording, with all that was detected and handled in ``report``.

    Raises:
        InputError: The recording is missing, damaged or without a mapped channel, a clock of
            it runs backwards, or a channel has too few usable samples.
    """
    path = Path(path)
    # A valve may well have the name of its command.
    valves = {f"{valve}.position": valve for valve in positions or {}}
    spools = {name: (positions or {})[valve] for name, valve in valves.items()}
    encoders = encoders or {}
    _check_arguments(path, commands, {**pressures, **encoders}, spools, rate_hz, start_s, end_s)
    if _is_bag(path):
        streams, findings = read_bag(path, commands, pressures, spools, encoders)
    else:
        layout = text or TextFormat()
        streams, findings = read_text(path, commands, pressures, layout, spools, encoders)
    for stream in streams:
        if not len(stream):
            raise InputError(f"{path}: {stream.label} has no samples")
    streams, found = _readable(streams)
    findings += found

    wanted = {
        name: channel.stamp
        for channels in (commands, pressures, encoders, spools)
        for name, channel in channels.items()
    }
    streams, found = choose_clock(streams, wanted, str(path))
    findings += found
    streams, found = mend_clock_jumps(streams)
    findings += found
    cleaned, measured = [], []
    for stream in streams:
        if len(stream):
            stream, found = clean(str(path), stream)
            findings += found
        if stream.role == "position":
            measured.append(stream)
            continue
        least = MIN_SAMPLES if stream.role in READ else 1
        if len(stream) < least:
            raise InputError(
                f"{path}: {stream.label} has {len(stream)} usable sample(s), "
                f"at least {least} are needed"
            )
        cleaned.append(stream)

    first_ns, last_ns, found = _common_time(str(path), cleaned)
    findings += found
    held = [s for s in cleaned if s.role == "command"]
    taps = [s for s in cleaned if s.role in READ]
    begin_ns = first_ns if start_s is None else first_ns + max(round(start_s * 1e9), 0)
    end_ns = last_ns if end_s is None else min(first_ns + round(end_s * 1e9), last_ns)
    kept = [s.pick((s.stamp_ns >= begin_ns) & (s.stamp_ns <= end_ns)) for s in taps]
    for stream, whole in zip(kept, taps, strict=True):
        if len(stream) < MIN_SAMPLES:
            raise InputError(
                f"{path}: {stream.label} has {len(stream)} usable sample(s) in the part read "
                f"(of {len(whole)}), at least {MIN_SAMPLES} are needed"
            )
    origin_ns = min(int(s.stamp_ns[0]) for s in kept)
    until_ns = max(int(s.stamp_ns[-1]) for s in kept)
    recording = Recording(
        name=path.name.removesuffix(".zstd").rsplit(".", 1)[0] if path.is_file() else path.name,
        commands={s.name: _signal(s.pick(s.stamp_ns <= until_ns), origin_ns) for s in held},
        pressures={},
        report=findings,
        start_time_s=origin_ns / 1e9,
    )
    for stream in kept:
        findings += _describe_gaps(stream, origin_ns, until_ns)
        if rate_hz is not None:
            stream, found = _thin(str(path), stream, origin_ns, rate_hz)
            findings += found
        of_role = recording.pressures if stream.role == "pressure" else recording.encoders
        of_role[stream.name] = _signal(stream, origin_ns)
    for stream in measured:
        inside = (stream.stamp_ns >= origin_ns) & (stream.stamp_ns <= until_ns)
        if np.count_nonzero(inside) < MIN_SAMPLES:
            why = (
                f"{np.count_nonzero(inside)} usable sample(s) of {len(stream)} lie within the "
                f"readings of the taps, at least {MIN_SAMPLES} are needed"
            )
            findings.append(absent(stream.name, why))
            continue
        stream = stream.pick(inside)
        findings += _describe_gaps(stream, origin_ns, until_ns)
        recording.positions[valves[stream.name]] = _signal(stream, origin_ns)
    return recording


def _readable(streams: list[Stream]) -> tuple[list[Stream], list[Finding]]:
    """Streams without the positions that have no number at all."""
    kept, findings = [], []
    for stream in streams:
        if stream.role == "position" and not np.isfinite(stream.values).any():
            findings.append(absent(stream.name, f"all {len(stream)} values are missing"))
        else:
            kept.append(stream)
    return kept, findings


def _signal(stream: Stream, origin_ns: int) -> Signal:
    """Samples of a channel in s after an origin; the difference is exact in integers."""
    return Signal((stream.stamp_ns - origin_ns) / 1e9, stream.values)


def _common_time(path: str, streams: list[Stream]) -> tuple[int, int, list[Finding]]:
    """First and last stamp between which readings and every command are there.

    Args:
        path: Recording, for messages.
        streams: Clean streams, at least one of them a pressure.

    Raises:
        InputError: Channels have no time in common.
    """
    taps = [s for s in streams if s.role in READ]
    held = [s for s in streams if s.role == "command"]
    latest = max(streams, key=lambda s: s.stamp_ns[0])
    earliest = min(streams, key=lambda s: s.stamp_ns[-1])
    apart_ns = int(latest.stamp_ns[0]) - int(earliest.stamp_ns[-1])
    # A command sent on events holds, and a tap may fall silent where another begins.
    lasting = (earliest.role == "command" and not is_regular(earliest)) or (
        earliest.role in READ and latest.role in READ
    )
    if apart_ns > (_APART_NS if lasting else 0):
        raise InputError(
            f"{path}: no time in common: {earliest.label} ends {apart_ns * 1e-9:.6g} s before "
            f"{latest.label} begins"
        )
    findings = []
    first_ns = min(int(s.stamp_ns[0]) for s in taps)
    last_ns = max(int(s.stamp_ns[-1]) for s in taps)
    if held:
        known = max(held, key=lambda s: s.stamp_ns[0])
        known_ns = int(known.stamp_ns[0])
        if early := sum(int(np.count_nonzero(s.stamp_ns < known_ns)) for s in taps):
            note = (
                f"reading(s) in the {(known_ns - first_ns) * 1e-9:.6g} s before its first sample "
                "were left out"
            )
            spans = ((first_ns, known_ns),)
            findings.append(Finding(known.name, "cropped", early, note, spans))
            first_ns = min(
                (int(s.stamp_ns[s.stamp_ns >= known_ns][0]) for s in taps if _reaches(s, known_ns)),
                default=known_ns,
            )
    pace_ns = float(np.median([median_period_ns(s.stamp_ns) for s in taps]))
    for stream in held:
        end_ns = int(stream.stamp_ns[-1])
        grace_ns = GAP_PERIODS * max(median_period_ns(stream.stamp_ns), pace_ns)
        if is_regular(stream) and last_ns > end_ns + grace_ns:
            late = sum(int(np.count_nonzero(s.stamp_ns > end_ns)) for s in taps)
            note = (
                f"reading(s) in the {(last_ns - end_ns) * 1e-9:.6g} s after its last sample were "
                "left out"
            )
            spans = ((end_ns, last_ns),)
            findings.append(Finding(stream.name, "cropped", late, note, spans))
            last_ns = end_ns
    return first_ns, last_ns, findings


def _reaches(stream: Stream, stamp_ns: int) -> bool:
    return int(stream.stamp_ns[-1]) >= stamp_ns


def _describe_gaps(stream: Stream, begin_ns: int, end_ns: int) -> list[Finding]:
    """Tell how much of a recording a tap misses."""
    edges = np.concatenate(([begin_ns], stream.stamp_ns, [end_ns]))
    steps = np.diff(edges)
    wide = np.flatnonzero(steps > LONGEST_STEP * median_period_ns(stream.stamp_ns))
    gaps = steps[wide]
    if not gaps.size:
        return []
    note = (
        f"gap(s) longer than {GAP_PERIODS:g} sample periods, {gaps.sum() * 1e-9:.6g} s or "
        f"{100.0 * gaps.sum() / (end_ns - begin_ns):.2g} % of the recording in all, the longest "
        f"{gaps.max() * 1e-9:.6g} s; nothing stands in for what is missing"
    )
    spans = longest(edges[wide], edges[wide + 1])
    return [Finding(stream.name, "gap", int(gaps.size), note, spans)]


def _thin(
    path: str, stream: Stream, origin_ns: int, rate_hz: float
) -> tuple[Stream, list[Finding]]:
    """Pick the first reading of each beat of a rate."""
    # A reading on the beat may be a rounding error before it.
    beat = np.floor((stream.stamp_ns - origin_ns) * (rate_hz * 1e-9) + 1e-6)
    picked = np.flatnonzero(np.concatenate(([True], np.diff(beat) > 0.0)))
    if picked.size == len(stream):
        return stream, []
    if picked.size < MIN_SAMPLES:
        raise InputError(
            f"{path}: {stream.label} has {picked.size} reading(s) left at rate_hz {rate_hz:g} of "
            f"{len(stream)}, at least {MIN_SAMPLES} are needed (choose a higher rate)"
        )
    note = f"reading(s) were left out to keep at most {rate_hz:g} per second, without a filter"
    return stream.pick(picked), [
        Finding(stream.name, "thinned", len(stream) - int(picked.size), note)
    ]


def _check_arguments(
    path: Path,
    commands: dict[str, Channel],
    pressures: dict[str, Channel],
    spools: dict[str, Channel],
    rate_hz: float | None,
    start_s: float | None,
    end_s: float | None,
) -> None:
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if not pressures:
        raise InputError(f"{path}: no tap or encoder is mapped, at least one is needed")
    if both := (commands.keys() & pressures.keys()) | (
        spools.keys() & (commands.keys() | pressures.keys())
    ):
        raise InputError(
            f"{path}: '{min(both)}' names two of commands, taps and measured positions; names "
            "must be different"
        )
    if rate_hz is not None and not 0.0 < rate_hz < 1e7:
        raise InputError(f"{path}: rate_hz is {rate_hz}, it must be above 0 and below 1e7")
    if start_s is not None and end_s is not None and not start_s < end_s:
        raise InputError(f"{path}: start_s ({start_s}) must be before end_s ({end_s})")


def _is_bag(path: Path) -> bool:
    """Return whether a path is to be read as a bag; raise for other bag formats."""
    if path.is_dir():
        return True
    if path.suffix in (".db3", ".bag"):
        raise InputError(f"{path}: '{path.suffix}' storage is not read, only MCAP and text are")
    if path.name.endswith((".mcap", ".mcap.zstd")):
        return True
    try:
        with path.open("rb") as file:
            return file.read(len(_MCAP_MAGIC)) == _MCAP_MAGIC
    except OSError as err:
        raise InputError(f"{path}: cannot be read ({err.strerror})") from err
