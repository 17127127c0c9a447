# SPDX-License-Identifier: Apache-2.0
"""Which clock stamps each sample, and what to do where that clock jumps."""

from dataclasses import replace
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sysid.records.recording import Finding, longest
from pneu_sysid.records.stream import Stream, median_period_ns

_REORDER_SAMPLES = 10  # a stream this many samples behind was reordered; more, its clock jumped
_FORWARD_JUMP_NS = 3_600_000_000_000  # an hour without a sample: a wrong clock, not a pause
_OFFSET_NS = 20_000_000  # log and header this far apart are worth a word: 10 samples at 500 Hz
_SEAM_SAMPLES = 50


def choose_clock(
    streams: list[Stream],
    wanted: dict[str, Literal["auto", "header", "log"]],
    path: str = "recording",
) -> tuple[list[Stream], list[Finding]]:
    """Stamp each stream by its header where there is one, else by the log time.

    Header stamps that are all zero (never filled in) count as absent. Where
    header-stamped and log-stamped channels share no time at all, as with simulated time
    in the headers, the log time is used for all that leave the choice open, as it is
    for one whose header stamps run backwards.

    Args:
        streams: Streams in order of arrival.
        wanted: Clock asked for, by channel name.
        path: Recording, for messages.

    Returns:
        The streams with ``stamp_ns`` set, and the findings.

    Raises:
        InputError: The clock of a channel runs backwards.
    """
    findings: list[Finding] = []
    chosen: list[Stream] = []
    by_header: list[bool] = []
    for stream in streams:
        use = stream.header_ns is not None and wanted[stream.name] != "log"
        if use:
            assert stream.header_ns is not None
            filled = stream.header_ns != 0
            if not filled.any():
                use = False
                note = "every header stamp is zero; the log time was used"
                findings.append(Finding(stream.name, "no_header_stamp", len(stream), note))
            elif not filled.all():
                count = int((~filled).sum())
                note = "sample(s) with a zero header stamp were dropped"
                findings.append(Finding(stream.name, "no_header_stamp", count, note))
                stream = stream.pick(filled)
        if use and wanted[stream.name] == "auto":
            assert stream.header_ns is not None
            if runs_backwards(stream.header_ns) and not runs_backwards(stream.log_ns):
                use = False
                note = "the header stamps run backwards; the log time was used"
                findings.append(Finding(stream.name, "clock_jump", len(stream), note))
        if use:
            assert stream.header_ns is not None
            stream = replace(stream, stamp_ns=stream.header_ns)
        chosen.append(stream)
        by_header.append(use)

    header_open = [s for s, h in zip(chosen, by_header, strict=True) if h]
    log_only = [s for s, h in zip(chosen, by_header, strict=True) if not h]
    if (
        header_open
        and log_only
        and all(wanted[s.name] == "auto" for s in header_open)
        and not any(_overlap(a, b) for a in header_open for b in log_only)
    ):
        note = (
            "header stamps and log times of this bag share no time, so they are different "
            "clocks; the log time was used for this channel"
        )
        for i, stream in enumerate(chosen):
            if by_header[i]:
                chosen[i] = replace(stream, stamp_ns=stream.log_ns)
                by_header[i] = False
                findings.append(Finding(stream.name, "clock_offset", len(stream), note))
    for stream, use in zip(chosen, by_header, strict=True):
        if runs_backwards(stream.stamp_ns):
            steps = np.diff(stream.stamp_ns)
            raise InputError(
                f"{path}: {stream.label}: its {'header stamps' if use else 'times'} run backwards "
                f"in {int((steps < 0).sum())} of {steps.size} steps, a clock that runs forward is "
                "needed"
            )
        if use:
            findings += _compare_with_log(stream)
    return chosen, findings


def runs_backwards(stamp_ns: NDArray[np.int64]) -> bool:
    """Return whether a clock runs backwards or to and fro, rather than jumping at times.

    Args:
        stamp_ns: (n,) stamps in the order of arrival, ns.
    """
    if len(stamp_ns) < 3:
        return False
    lag = _REORDER_SAMPLES + 1  # what is reordered only is not behind by so many
    if len(stamp_ns) <= 2 * lag:
        return bool(np.all(np.diff(stamp_ns) < 0))
    falls = np.diff(stamp_ns) < -_REORDER_SAMPLES * median_period_ns(stamp_ns)
    return bool(np.mean(stamp_ns[lag:] < stamp_ns[:-lag]) > 0.4 or np.mean(falls) > 0.05)


def _overlap(a: Stream, b: Stream) -> bool:
    return bool(a.stamp_ns.min() <= b.stamp_ns.max() and b.stamp_ns.min() <= a.stamp_ns.max())


def _compare_with_log(stream: Stream) -> list[Finding]:
    """Report a header clock that is offset from the recorder's, or runs at another rate."""
    findings = []
    lag_ns = stream.log_ns - stream.stamp_ns
    offset_ns = float(np.median(lag_ns))
    if abs(offset_ns) > _OFFSET_NS:
        note = (
            f"header stamps are {abs(offset_ns) * 1e-9:.6g} s "
            f"{'before' if offset_ns > 0 else 'after'} the log time (median); header stamps were "
            "used, channels without them are on the log clock"
        )
        findings.append(Finding(stream.name, "clock_offset", len(stream), note))
    header, log = median_period_ns(stream.stamp_ns), median_period_ns(stream.log_ns)
    if header > 0 and log > 0 and len(stream) >= 20 and not 0.9 < header / log < 1.1:
        note = (
            f"header stamps step by {header * 1e-9:.6g} s and log times by {log * 1e-9:.6g} s "
            "(medians); header stamps were used"
        )
        findings.append(Finding(stream.name, "clock_rate", len(stream), note))
    return findings


def mend_clock_jumps(streams: list[Stream]) -> tuple[list[Stream], list[Finding]]:
    """Repair or cut streams whose clock jumped while recording.

    A header clock that jumped while the log clock ran on is shifted to follow the log
    clock. Where no clock ran through, the longest stretch between jumps is kept, for
    all channels alike. Single stamps far from both their neighbours are dropped.

    Args:
        streams: All channels of the recording.
    """
    findings: list[Finding] = []
    mended = []
    for stream in streams:
        stream, found = _drop_stray_stamps(stream)
        findings += found
        stream, found = _follow_log_clock(stream)
        findings += found
        mended.append(stream)
    for i in range(len(mended)):
        stream = mended[i]
        cuts = clock_jumps(stream.stamp_ns)
        if not cuts:
            continue
        edges = [0, *cuts, len(stream)]
        spans = [int(np.ptp(stream.stamp_ns[a:b])) for a, b in pairwise(edges)]
        best = int(np.argmax(spans))
        a, b = edges[best], edges[best + 1]
        after = stream.arrival[a - 1] if a > 0 else -1
        before = stream.arrival[b] if b < len(stream) else np.iinfo(np.int64).max
        note = (
            f"the clock jumped {len(cuts)} time(s); the longest stretch "
            f"({spans[best] * 1e-9:.6g} s, {b - a} of {len(stream)} samples) was kept, "
            "of every channel"
        )
        findings.append(Finding(stream.name, "clock_jump", len(cuts), note))
        mended = [s.pick((s.arrival > after) & (s.arrival < before)) for s in mended]
    return mended, findings


def clock_jumps(stamp_ns: NDArray[np.int64]) -> list[int]:
    """Return the indices at which a new time line begins.

    A sample behind its predecessors is late, not a jump, if the stream is back in front
    within 10 samples.

    Args:
        stamp_ns: (n,) stamps in the order of arrival, ns.
    """
    period = median_period_ns(stamp_ns)
    cuts: list[int] = []
    start = 0
    while start < len(stamp_ns) - 1:
        rest = stamp_ns[start:]
        front = np.maximum.accumulate(rest)
        late = rest[1:] < front[:-1]
        edge = np.flatnonzero(np.diff(np.concatenate(([0], late.view(np.int8), [0]))))
        cut = len(rest)
        for a, b in zip(edge[::2] + 1, edge[1::2] + 1, strict=True):
            behind = front[a - 1] - rest[a]
            unreturned = b == len(rest) and behind > _REORDER_SAMPLES * period
            if b - a > _REORDER_SAMPLES or unreturned:
                cut = int(a)
                break
        forward = np.flatnonzero(np.diff(rest) > max(_FORWARD_JUMP_NS, 1000 * period))
        if forward.size:
            cut = min(cut, int(forward[0]) + 1)
        if cut == len(rest):
            break
        cuts.append(start + cut)
        start += cut
    return cuts


def _drop_stray_stamps(stream: Stream) -> tuple[Stream, list[Finding]]:
    """Drop single samples whose stamp is far from both neighbours', which agree."""
    t = stream.stamp_ns
    period = median_period_ns(t)
    if len(t) < 3 or period == 0.0:
        return stream, []
    far = np.abs(np.diff(t)) > 100 * period
    close = np.abs(t[2:] - t[:-2]) <= 10 * period
    stray = np.concatenate(([False], far[:-1] & far[1:] & close, [False]))
    if not stray.any():
        return stream, []
    note = "single sample(s) stamped far from both neighbours were dropped"
    # what it is stamped is wrong: it lies between its neighbours
    at = np.flatnonzero(stray)
    spans = longest(t[at - 1], t[at + 1])
    return stream.pick(~stray), [Finding(stream.name, "clock_jump", int(stray.sum()), note, spans)]


def _follow_log_clock(stream: Stream) -> tuple[Stream, list[Finding]]:
    """Shift the stretches between jumps so that all lag the log clock like the longest."""
    if np.array_equal(stream.stamp_ns, stream.log_ns):
        return stream, []
    cuts = clock_jumps(stream.stamp_ns)
    if not cuts or clock_jumps(stream.log_ns):
        return stream, []
    lag = stream.log_ns - stream.stamp_ns
    edges = [0, *cuts, len(stream)]
    shifts = [0]
    for before, cut, after in zip(edges, cuts, edges[2:], strict=False):
        # The seam's medians leave out the transport delay, which has a tail on one side.
        old = np.median(lag[max(before, cut - _SEAM_SAMPLES) : cut])
        new = np.median(lag[cut : min(after, cut + _SEAM_SAMPLES)])
        shifts.append(shifts[-1] + round(float(new - old)))
    longest = int(np.argmax(np.diff(edges)))
    stamp = stream.stamp_ns.copy()
    for shift, (a, b) in zip(shifts, pairwise(edges), strict=True):
        stamp[a:b] += shift - shifts[longest]
    steps = ", ".join(f"{-step * 1e-9:.6g}" for step in np.diff(shifts)[:5])
    note = (
        f"the header clock jumped by {steps} s while the log clock ran on; the stamps were "
        "shifted to keep their lag behind the log clock"
    )
    return replace(stream, stamp_ns=stamp), [Finding(stream.name, "clock_jump", len(cuts), note)]
