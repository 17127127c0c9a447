# SPDX-License-Identifier: Apache-2.0
"""Defects of one channel's samples: order, duplicates, NaN, frozen values, gaps.

Each function takes a stream and returns it repaired with what was found. Time is
judged here, too, but only described: samples that are left keep their stamps.
"""

import numpy as np

from pneu_common.errors import InputError
from pneu_sysid.records.noise import noise_floor
from pneu_sysid.records.recording import MOST_SPANS, Finding, longest, spans_of
from pneu_sysid.records.stream import GAP_PERIODS, LONGEST_STEP, Stream, median_period_ns

_FROZEN_SAMPLES = 100


def clean(path: str, stream: Stream) -> tuple[Stream, list[Finding]]:
    """Sort, deduplicate and drop unusable samples of a stream, and describe the rest.

    Args:
        path: Recording, for messages.
        stream: Samples on one time line.

    Returns:
        The stream with increasing stamps and finite values, and the findings.

    Raises:
        InputError: No value of the channel is finite.
    """
    findings: list[Finding] = []
    for repair in (_sort, _deduplicate):
        stream, found = repair(stream)
        findings += found
    stream, found = _drop_not_finite(path, stream)
    findings += found
    stream, found = _drop_frozen(stream)
    findings += found
    findings += _describe_timing(stream)
    findings += _describe_level(stream)
    return stream, findings


def is_regular(stream: Stream) -> bool:
    """Return whether a channel is sampled at a rate, rather than sent on events.

    Args:
        stream: The channel.
    """
    steps = np.diff(stream.stamp_ns)
    if len(steps) < 10:
        return False
    period = float(np.median(steps))
    return bool(np.mean(np.abs(steps - period) < 0.5 * period) > 0.8)


def _sort(stream: Stream) -> tuple[Stream, list[Finding]]:
    late = stream.stamp_ns[1:] < np.maximum.accumulate(stream.stamp_ns)[:-1]
    if not late.any():
        return stream, []
    note = "sample(s) arrived after later ones; sorted by stamp"
    order = np.argsort(stream.stamp_ns, kind="stable")
    spans = tuple((int(t), int(t)) for t in np.sort(stream.stamp_ns[1:][late])[:MOST_SPANS])
    return stream.pick(order), [Finding(stream.name, "out_of_order", int(late.sum()), note, spans)]


def _deduplicate(stream: Stream) -> tuple[Stream, list[Finding]]:
    same = np.diff(stream.stamp_ns) == 0
    if not same.any():
        return stream, []
    if stream.role == "command":  # the command that came last is the one that stands
        keep, which = np.concatenate((~same, [True])), "last"
    else:
        keep, which = np.concatenate(([True], ~same)), "first"
    note = f"sample(s) with the stamp of another; the {which} to arrive was kept"
    spans = spans_of(stream.stamp_ns, ~keep)
    return stream.pick(keep), [Finding(stream.name, "duplicate", int(same.sum()), note, spans)]


def _drop_not_finite(path: str, stream: Stream) -> tuple[Stream, list[Finding]]:
    finite = np.isfinite(stream.values)
    if finite.all():
        return stream, []
    if not finite.any():
        raise InputError(
            f"{path}: {stream.label}: all {len(stream)} values are NaN or infinite, "
            "finite numbers are needed"
        )
    note = "NaN or infinite value(s) were dropped and count as missing"
    count = int((~finite).sum())
    spans = spans_of(stream.stamp_ns, ~finite)
    return stream.pick(finite), [Finding(stream.name, "not_finite", count, note, spans)]


def _drop_frozen(stream: Stream) -> tuple[Stream, list[Finding]]:
    """Report a constant channel; drop long stretches in which a noisy pressure stands still."""
    values = stream.values
    if len(values) < 2:
        return stream, []
    if np.all(values == values[0]):
        kind = "constant" if stream.role == "command" else "frozen"
        note = f"the value never changes ({values[0]:.6g}); kept, but it tells nothing"
        return stream, [Finding(stream.name, kind, len(values), note)]
    if stream.role != "pressure":  # gas is never still, a spool that rests is
        return stream, []
    starts = np.concatenate(([0], np.flatnonzero(np.diff(values) != 0) + 1, [len(values)]))
    lengths = np.diff(starts)
    usual = np.percentile(lengths, 99)
    long = np.flatnonzero(lengths > max(_FROZEN_SAMPLES, 10 * usual))
    # Without noise a channel may rest for long; only a noisy one that stands still is stuck.
    if not long.size:
        return stream, []
    time_s = (stream.stamp_ns - stream.stamp_ns[0]) / 1e9
    if not noise_floor(time_s, values).sigma_pa >= 2e-5 * np.ptp(values):
        return stream, []
    keep = np.ones(len(values), dtype=bool)
    for k in long:
        keep[starts[k] + 1 : starts[k + 1]] = False
    count = int((~keep).sum())
    first_s = (stream.stamp_ns[starts[long[0]]] - stream.stamp_ns[0]) * 1e-9
    note = (
        f"samples repeat one value in {long.size} stretch(es), the first {first_s:.6g} s into the "
        "channel, though it is noisy elsewhere; they were dropped and count as missing"
    )
    spans = spans_of(stream.stamp_ns, ~keep)
    return stream.pick(keep), [Finding(stream.name, "frozen", count, note, spans)]


def _describe_timing(stream: Stream) -> list[Finding]:
    """Describe missing samples, gaps and jitter."""
    findings: list[Finding] = []
    steps = np.diff(stream.stamp_ns)
    if not steps.size:
        return findings
    period = median_period_ns(stream.stamp_ns)
    if stream.role == "command" and not is_regular(stream):
        note = "not sampled at a rate; each value holds until the next"
        return [Finding(stream.name, "event_driven", len(stream), note)]
    gaps = steps > LONGEST_STEP * period
    short = (steps > 1.5 * period) & ~gaps
    if short.any() and is_regular(stream):
        count = int(np.rint(steps[short] / period - 1).sum())
        note = f"missing sample(s), of which never more than {GAP_PERIODS - 1:g} in a row"
        spans = longest(stream.stamp_ns[:-1][short], stream.stamp_ns[1:][short])
        findings.append(Finding(stream.name, "missing", count, note, spans))
    if gaps.any() and stream.role == "command":  # those of a tap are told with the whole recording
        note = (
            f"gap(s) longer than {GAP_PERIODS:g} sample periods, {steps[gaps].sum() * 1e-9:.6g} s "
            f"in all, the longest {steps.max() * 1e-9:.6g} s; the value before each holds"
        )
        spans = longest(stream.stamp_ns[:-1][gaps], stream.stamp_ns[1:][gaps])
        findings.append(Finding(stream.name, "gap", int(gaps.sum()), note, spans))
    near = steps <= 1.5 * period
    jitter = np.abs(steps[near] - period) / period
    uneven = int((jitter > 0.1).sum())
    if uneven:
        note = (
            f"step(s) off the median period of {period * 1e-6:.6g} ms by more than a tenth, "
            f"{100 * float(np.sqrt(np.mean(jitter**2))):.3g} % rms; each keeps its time"
        )
        findings.append(Finding(stream.name, "irregular", uneven, note))
    return findings


def _describe_level(stream: Stream) -> list[Finding]:
    """Warn of a pressure that is hardly in absolute pascals."""
    if stream.role != "pressure":
        return []
    level = float(np.median(stream.values))
    if 1e3 < level < 1e8:
        return []
    note = (
        f"the median is {level:.6g} Pa, unlikely for an absolute pressure in pascals; "
        "kept (check scale and offset of the channel)"
    )
    return [Finding(stream.name, "suspicious_unit", len(stream), note)]
