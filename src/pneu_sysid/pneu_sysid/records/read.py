# SPDX-License-Identifier: Apache-2.0
"""One call from a bag or a text file to a recording on a uniform grid."""

from pathlib import Path

import numpy as np

from pneu_sim.channels import Channel, TextFormat
from pneu_sim.errors import InputError
from pneu_sysid.records.bag import read_bag
from pneu_sysid.records.clean import clean
from pneu_sysid.records.clock import choose_clock, mend_clock_jumps
from pneu_sysid.records.grid import hold, interpolate, make_grid
from pneu_sysid.records.recording import Recording
from pneu_sysid.records.text import read_text

MIN_SAMPLES = 20
_MCAP_MAGIC = b"\x89MCAP"


def read_recording(
    path: str | Path,
    *,
    commands: dict[str, Channel],
    pressures: dict[str, Channel],
    text: TextFormat | None = None,
    rate_hz: float | None = None,
    start_s: float | None = None,
    end_s: float | None = None,
) -> Recording:
    """Read commands and pressures of a recording onto one uniform grid.

    Samples that stand on the grid within 5 % of a period are taken unaltered. Elsewhere
    commands are held and pressures interpolated, with NaN in gaps longer than three
    sample periods. A lower ``rate_hz`` than recorded picks samples and does not filter.

    Args:
        path: rosbag2 MCAP folder, .mcap file, or text file.
        commands: Held channels by name; may be empty.
        pressures: Pressure channels by tap, at least one.
        text: Layout of the rows, if the file is text.
        rate_hz: Grid rate; the median rate of the pressures if not given.
        start_s: Start of the part to keep, in s after the start of the recording.
        end_s: End of the part to keep, in s after the start of the recording.

    Returns:
        The recording, with all that was detected and handled in ``report``.

    Raises:
        InputError: The recording is missing, damaged or without a mapped channel, or a
            channel has too few usable samples.
    """
    path = Path(path)
    _check_arguments(path, commands, pressures, rate_hz, start_s, end_s)
    if _is_bag(path):
        streams, findings = read_bag(path, commands, pressures)
    else:
        streams, findings = read_text(path, commands, pressures, text or TextFormat())
    for stream in streams:
        if not len(stream):
            raise InputError(f"{path}: {stream.label} has no samples")

    wanted = {name: channel.stamp for name, channel in {**commands, **pressures}.items()}
    streams, found = choose_clock(streams, wanted)
    findings += found
    streams, found = mend_clock_jumps(streams)
    findings += found
    cleaned = []
    for stream in streams:
        if len(stream):
            stream, found = clean(str(path), stream)
            findings += found
        least = MIN_SAMPLES if stream.role == "pressure" else 1
        if len(stream) < least:
            raise InputError(
                f"{path}: {stream.label} has {len(stream)} usable sample(s), "
                f"at least {least} are needed"
            )
        cleaned.append(stream)

    grid, found = make_grid(str(path), cleaned, rate_hz)
    findings += found
    first = 0 if start_s is None else max(round(start_s / grid.period_s), 0)
    last = grid.count if end_s is None else min(round(end_s / grid.period_s) + 1, grid.count)
    part = slice(first, last)
    recording = Recording(
        name=path.name.removesuffix(".zstd").rsplit(".", 1)[0] if path.is_file() else path.name,
        time_s=grid.period_s * np.arange(max(last - first, 0), dtype=np.float64),
        commands={},
        pressures={},
        rate_hz=1.0 / grid.period_s,
        report=findings,
        start_time_s=grid.origin_ns * 1e-9 + grid.start_s + first * grid.period_s,
    )
    for stream in cleaned:
        if stream.role == "command":
            recording.commands[stream.name] = hold(stream, grid)[part]
            continue
        values, found = interpolate(stream, grid)
        findings += found
        recording.pressures[stream.name] = values[part]
        usable = int(np.isfinite(values[part]).sum())
        if usable < MIN_SAMPLES:
            raise InputError(
                f"{path}: {stream.label} has {usable} usable sample(s) in the part read "
                f"({len(recording.time_s)} grid points), at least {MIN_SAMPLES} are needed"
            )
    return recording


def _check_arguments(
    path: Path,
    commands: dict[str, Channel],
    pressures: dict[str, Channel],
    rate_hz: float | None,
    start_s: float | None,
    end_s: float | None,
) -> None:
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if not pressures:
        raise InputError(f"{path}: no pressure channel is mapped, at least one is needed")
    if both := commands.keys() & pressures.keys():
        raise InputError(
            f"{path}: '{min(both)}' names both a command and a tap; names must be different"
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
