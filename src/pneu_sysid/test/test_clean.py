# SPDX-License-Identifier: Apache-2.0
"""Each repair of a channel's samples, and the limits from which something is told."""

import re
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from pneu_common.errors import InputError
from pneu_sysid.records.clean import clean, is_regular
from pneu_sysid.records.read import _describe_gaps
from pneu_sysid.records.recording import Finding
from pneu_sysid.records.stream import Role, Stream, median_period_ns

pytestmark = pytest.mark.kernel_free

PERIOD_NS = 2_000_000


def stream_of(
    stamp_ns: ArrayLike, values: ArrayLike | None = None, role: Role = "pressure"
) -> Stream:
    stamp = np.asarray(stamp_ns, dtype=np.int64)
    n = stamp.size
    given = 2e5 + np.arange(n) if values is None else np.asarray(values, dtype=float)
    return Stream("s", role, "a file", np.arange(n), stamp, None, given, stamp)


def steps(*lengths: float, around: int = 20) -> Any:
    """Stamps whose steps are whole periods but for these, in periods."""
    every = [*[1.0] * around, *lengths, *[1.0] * around]
    return 5_000 + np.concatenate(([0], np.cumsum(np.rint(np.array(every) * PERIOD_NS)))).astype(
        np.int64
    )


def found_in(stream: Stream) -> dict[str, Finding]:
    _, findings = clean("f", stream)
    assert len({f.kind for f in findings}) == len(findings)
    assert all(f.channel == "s" for f in findings)
    return {f.kind: f for f in findings}


def test_jitter_is_relative_to_the_period() -> None:
    assert found_in(stream_of(steps(0.9, 1.1, 0.91, 1.09))) == {}
    off = (0.8, 1.3, 0.95)
    found = found_in(stream_of(steps(*off, 2.0, around=100)))["irregular"]
    rms = 100.0 * np.sqrt(sum((x - 1.0) ** 2 for x in off) / (200 + len(off)))
    assert found.count == 2 and found.spans_ns == ()
    assert found.action == (
        f"step(s) off the median period of 2 ms by more than a tenth, {rms:.3g} % rms;"
        " each keeps its time"
    )
    assert "irregular" in found_in(stream_of(steps(1.5)))  # longer ones count as missing


def test_missing_samples_and_gaps() -> None:
    stamp = steps(2.0, 1.0, 3.0, 1.0, 1.5, 1.0, 3.05, 1.0, 3.06)
    found = found_in(stream_of(stamp))
    assert found["missing"].count == 1 + 2 + 2
    assert "of which never more than 2 in a row" in found["missing"].action
    begins = 5_000 + PERIOD_NS * np.array([20.0, 23.0, 29.5])
    lengths = PERIOD_NS * np.array([2.0, 3.0, 3.05])
    wanted = [(int(a), int(a + b)) for a, b in zip(begins, lengths, strict=True)]
    assert list(found["missing"].spans_ns) == wanted
    assert "gap" not in found  # those of a tap are told with the whole recording
    command = found_in(stream_of(stamp, role="command"))["gap"]
    assert command.count == 1 and command.spans_ns[0][1] - command.spans_ns[0][0] == 6_120_000
    assert command.action == (
        "gap(s) longer than 3 sample periods, 0.00612 s in all, the longest 0.00612 s; the value"
        " before each holds"
    )


def test_gaps_of_a_tap_within_the_recording() -> None:
    stamp = steps(3.05, 3.06, 1.0, 8.0)
    begin, end = int(stamp[0]) - 7_000_000, int(stamp[-1]) + 6_100_000
    (found,) = _describe_gaps(stream_of(stamp), begin, end)
    assert found.kind == "gap" and found.count == 3
    gaps = [0.007, 0.00612, 0.016]
    share = 100.0 * sum(gaps) / (1e-9 * (end - begin))
    assert found.action == (
        f"gap(s) longer than 3 sample periods, {sum(gaps):.6g} s or {share:.2g} % of the recording"
        " in all, the longest 0.016 s; nothing stands in for what is missing"
    )
    assert [b - a for a, b in found.spans_ns] == [7_000_000, 6_120_000, 16_000_000]
    assert found.spans_ns[0] == (begin, int(stamp[0]))
    assert _describe_gaps(stream_of(steps(3.05)), int(stamp[0]), int(steps(3.05)[-1])) == []


def test_events_are_not_sampled() -> None:
    rng = np.random.default_rng(3)
    stamp = np.cumsum(rng.integers(1, 10**9, 40))
    (found,) = found_in(stream_of(stamp, role="command")).values()
    assert (found.kind, found.count) == ("event_driven", 40)
    assert "missing" not in found_in(stream_of(stamp))


@pytest.mark.parametrize(
    ("stamp", "regular"),
    [
        (PERIOD_NS * np.arange(11), True),
        (PERIOD_NS * np.arange(10), False),
        ([0], False),
        (np.cumsum([0, *[10] * 81, *[30] * 19]), True),
        (np.cumsum([0, *[10] * 80, *[30] * 20]), False),
        (np.cumsum([0, *[10] * 60, *[14] * 40]), True),
        (np.cumsum([0, *[10] * 60, *[15] * 40]), False),
        (np.cumsum([0, *[10] * 60, *[6] * 40]), True),
        (np.cumsum([0, *[10] * 60, *[5] * 40]), False),
    ],
)
def test_regular_channels(stamp: Any, regular: bool) -> None:
    assert is_regular(stream_of(stamp)) is regular


def test_late_samples_are_sorted() -> None:
    stamp = [10, 20, 50, 30, 40, 60, 70]
    values = 2e5 + np.array([1, 2, 5, 3, 4, 6, 7])
    mended, findings = clean("f", stream_of(stamp, values))
    assert mended.stamp_ns.tolist() == sorted(stamp)
    assert mended.values.tolist() == sorted(values)
    assert mended.arrival.tolist() == [0, 1, 3, 4, 2, 5, 6]
    assert (findings[0].kind, findings[0].count) == ("out_of_order", 2)
    assert findings[0].spans_ns == ((30, 30), (40, 40))


@pytest.mark.parametrize(("role", "kept"), [("command", [1, 4, 5, 6]), ("pressure", [0, 2, 5, 6])])
def test_of_samples_with_one_stamp_one_is_kept(role: Role, kept: list[int]) -> None:
    stamp = [10, 10, 20, 20, 20, 30, 40]
    mended, findings = clean("f", stream_of(stamp, role=role))
    assert mended.arrival.tolist() == kept
    found = findings[0]
    assert (found.kind, found.count) == ("duplicate", 3)
    assert f"the {'last' if role == 'command' else 'first'} to arrive was kept" in found.action
    assert found.spans_ns == ((10, 10), (20, 20))


def test_what_is_no_number_is_dropped() -> None:
    values = [2e5, np.nan, np.inf, 2.1e5, -np.inf, 2.2e5]
    mended, findings = clean("f", stream_of(10 * np.arange(6), values))
    assert mended.values.tolist() == [2e5, 2.1e5, 2.2e5]
    assert (findings[0].kind, findings[0].count) == ("not_finite", 3)
    assert findings[0].spans_ns == ((10, 20), (40, 40))
    message = "f: tap 's' (a file): all 3 values are NaN or infinite, finite numbers are needed"
    with pytest.raises(InputError, match=re.escape(message)):
        clean("f", stream_of([0, 1, 2], [np.nan] * 3))


@pytest.mark.parametrize(("role", "kind"), [("command", "constant"), ("pressure", "frozen")])
def test_a_value_that_never_changes_is_kept(role: Role, kind: str) -> None:
    mended, findings = clean("f", stream_of(PERIOD_NS * np.arange(30), [123456.0] * 30, role))
    assert len(mended) == 30
    assert [(f.kind, f.count) for f in findings] == [(kind, 30)]
    assert findings[0].action.startswith("the value never changes (123456); kept")
    _, findings = clean("f", stream_of([0, PERIOD_NS], [2e5, 2e5], role))
    assert (findings[0].kind, findings[0].count) == (kind, 2)
    assert clean("f", stream_of([0], [2e5], role))[1] == []


@pytest.mark.parametrize(("length", "role", "noise", "dropped"), [
    (101, "pressure", 30.0, 100), (100, "pressure", 30.0, 0), (150, "encoder", 30.0, 0),
    (150, "pressure", 0.0, 0),
])  # fmt: skip
def test_a_noisy_pressure_that_stands_still_is_stuck(
    length: int, role: Role, noise: float, dropped: int
) -> None:
    time = np.arange(3000)
    values = 3e5 + 2e4 * np.sin(0.004 * time)
    values += noise * np.random.default_rng(0).standard_normal(time.size)
    values[500 : 500 + length] = values[500]
    stream = stream_of(PERIOD_NS * time, values, role)
    mended, findings = clean("f", stream)
    frozen = [f for f in findings if f.kind == "frozen"]
    assert len(stream) - len(mended) == dropped == sum(f.count for f in frozen)
    for f in frozen:
        assert f.spans_ns == ((501 * PERIOD_NS, (499 + length) * PERIOD_NS),)
        assert "in 1 stretch(es), the first 1 s into the channel" in f.action
        assert np.isin(500 * PERIOD_NS, mended.stamp_ns)


@pytest.mark.parametrize(
    ("level", "expected"),
    [(1e3, True), (1001.0, False), (9.99e7, False), (1e8, True), (3.0, True), (-2e5, True)],
)
def test_levels_that_no_absolute_pressure_has(level: float, expected: bool) -> None:
    values = level * np.array([0.5, 1.0, 1.0, 1.5, 1.0])
    found = found_in(stream_of(PERIOD_NS * np.arange(5), values))
    assert ("suspicious_unit" in found) is expected
    if expected:
        assert found["suspicious_unit"].count == 5
        assert f"the median is {level:.6g} Pa" in found["suspicious_unit"].action
    for role in ("command", "encoder", "position"):
        assert "suspicious_unit" not in found_in(
            stream_of(PERIOD_NS * np.arange(5), values, role)  # type: ignore[arg-type]
        )


def test_median_period() -> None:
    assert median_period_ns(np.array([0, 10, 10, 40, 60])) == 20.0
    assert median_period_ns(np.array([5, 5])) == median_period_ns(np.array([5])) == 0.0
