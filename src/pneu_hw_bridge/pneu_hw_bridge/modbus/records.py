# SPDX-License-Identifier: Apache-2.0
"""Records that a device keeps of its samples and commands: which of those just read are new.

A reader that is late finds several new ones and takes them all; one that is early finds none, and
no sample is ever taken for two. Where number or time went back, the device has begun anew.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from pneu_hw_bridge.registers.clock import Records
from pneu_hw_bridge.registers.schema import RegisterMap


@dataclass(frozen=True)
class Record:
    """One sample, or one command.

    Attributes:
        device_ns: Its time by the device's clock, ns.
        values: SI value per tap or output; may be infinite or not a number.
    """

    device_ns: int
    values: dict[str, float]


@dataclass
class News:
    """What was new among the records that were read.

    Attributes:
        records: The new ones, oldest first.
        skipped: How many were lost between those read before and these.
        anew: In which way the device has begun anew; empty where it has not.
    """

    records: list[Record] = field(default_factory=list)
    skipped: int = 0
    anew: str = ""


class Reader:
    """Finds what is new in registers that were read one after the other."""

    def __init__(self, layout: Records, address: int, apart: bool) -> None:
        """Knows nothing yet: of what is read first, only the newest is new.

        Args:
            layout: Where number and time are.
            address: First register of what will be read.
            apart: Whether two records must differ in time.
        """
        self._layout = layout
        self._apart = apart
        self._counter_at = layout.counter.address - address
        self._time_at = layout.time.address - address
        self._last: tuple[int, int] | None = None
        self._ticks = 0

    def forget(self) -> None:
        """Begins anew, as with another device."""
        self._last = None

    def take(self, raw: Sequence[int]) -> tuple[list[tuple[int, int]], int, str]:
        """Finds the new records.

        Args:
            raw: The registers of all records.

        Returns:
            Per new record, oldest first, its place among the records and its device time, ns; how
            many were skipped; in which way the device has begun anew.
        """
        counter, ticks = self._numbers(raw, 0)
        anew = ""
        if self._last is not None:
            anew = self._back(counter, ticks)
        if self._last is None or anew:
            self._last, self._ticks = (counter, ticks), ticks
            return [(0, self._time_ns(ticks))], 0, anew
        before, before_ticks = self._last
        ahead = (counter - before) % self._layout.counter.modulus
        found = []
        newer = ahead + 1
        for place in range(self._layout.records):
            number, at = self._numbers(raw, place)
            # How much newer it is than the last one known; a record not yet used repeats another.
            since = (number - before) % self._layout.counter.modulus
            if not 0 < since < newer:
                break
            newer = since
            passed = (at - before_ticks) % self._layout.time.modulus
            found.append((place, self._time_ns(self._ticks + passed)))
        if ahead:
            self._ticks += (ticks - before_ticks) % self._layout.time.modulus
            self._last = counter, ticks
        return found[::-1], ahead - len(found), ""

    def _back(self, counter: int, ticks: int) -> str:
        """Says where number or time went back, or time does not go with the number."""
        assert self._last is not None
        ahead = (counter - self._last[0]) % self._layout.counter.modulus
        passed = (ticks - self._last[1]) % self._layout.time.modulus
        if ahead >= self._layout.counter.modulus // 2:
            return "the device's counter went back"
        if passed >= self._layout.time.modulus // 2:
            return "the device's clock went back"
        if self._apart and ahead and not passed:
            return "the device's clock stands still while its counter runs"
        if passed and not ahead:
            return "the device's clock was set"
        return ""

    def _numbers(self, raw: Sequence[int], place: int) -> tuple[int, int]:
        """Number and ticks of one record."""
        counter, time = self._layout.counter, self._layout.time
        at = place * self._layout.stride
        first, second = at + self._counter_at, at + self._time_at
        return (
            counter.decode(list(raw[first : first + counter.width])),
            time.decode(list(raw[second : second + time.width])),
        )

    def _time_ns(self, ticks: int) -> int:
        # In parts, since a product of floats would lose the nanoseconds of a long time.
        whole_ns = round(1e9 * self._layout.time.tick_s)
        rest_ns = 1e9 * self._layout.time.tick_s - whole_ns
        return ticks * whole_ns + round(ticks * rest_ns)


class SampleReader:
    """New samples out of the registers of a device with a clock."""

    def __init__(self, registers: RegisterMap) -> None:
        """Prepares.

        Args:
            registers: A map with a clock.
        """
        assert registers.clock is not None and registers.sample_span is not None
        self.span = registers.sample_span
        self._stride = registers.clock.samples.stride
        self._sampled = registers.sampled
        self._reader = Reader(registers.clock.samples, self.span.address, apart=True)

    def take(self, raw: Sequence[int]) -> News:
        """Returns what is new.

        Args:
            raw: The registers of the span.
        """
        found, skipped, anew = self._reader.take(raw)
        records = []
        for place, device_ns in found:
            start = place * self._stride - self.span.address
            values = {
                name: one.decode(list(raw[start + one.address : start + one.address + one.width]))
                for name, one in self._sampled.items()
            }
            records.append(Record(device_ns, values))
        return News(records, skipped, anew)


class CommandReader:
    """New commands out of the registers of a device that tells when it took them."""

    def __init__(self, registers: RegisterMap) -> None:
        """Prepares.

        Args:
            registers: A map with a clock that tells of commands.
        """
        assert registers.clock is not None and registers.clock.commands is not None
        span = registers.command_span
        assert span is not None
        self.span = span
        self._layout = registers.clock.commands
        self._outputs = registers.outputs
        # Two commands may act from the same moment on: then the latter does.
        self._reader = Reader(self._layout, self.span.address, apart=False)

    def forget(self) -> None:
        """Begins anew, as with another device."""
        self._reader.forget()

    def take(self, raw: Sequence[int]) -> News:
        """Returns what is new.

        Args:
            raw: The registers of the span.
        """
        found, skipped, anew = self._reader.take(raw)
        records = []
        for place, device_ns in found:
            start = place * self._layout.stride - self.span.address
            values = {}
            for name, output in self._outputs.items():
                at = start + self._layout.values[name]
                values[name] = output.decode(list(raw[at : at + output.width]))
            records.append(Record(device_ns, values))
        return News(records, skipped, anew)
