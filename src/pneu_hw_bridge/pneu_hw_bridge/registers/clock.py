# SPDX-License-Identifier: Apache-2.0
"""The part of a register map that says where a device tells its own time of samples and commands.

A sample is a record: a counter, the device's time, and all taps, read in one request so that they
belong together. A device that keeps the latest samples shows several records, the newest first, so
that a late reader loses none. The same holds for the commands that it took.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pydantic import Field, model_validator

from pneu_hw_bridge.registers.codec import Order, count_from_registers, to_registers, width
from pneu_hw_bridge.registers.part import Part, Positive

WordTable = Literal["holding", "input"]


@dataclass(frozen=True)
class Span:
    """Registers that follow each other.

    Attributes:
        table: Modbus table.
        address: The first.
        count: How many.
    """

    table: WordTable
    address: int
    count: int


class Count(Part):
    """A whole number that only grows, and begins at 0 again beyond its type.

    Attributes:
        table: ``holding`` or ``input``.
        address: First register, counted from 0 as on the wire.
        type: Type of the number.
        word_order: ``big`` where the most significant register comes first.
        byte_order: ``big`` where the most significant byte of a register comes first.
    """

    table: WordTable = "input"
    address: int = Field(ge=0, le=65535)
    type: Literal["uint16", "uint32", "uint64"] = "uint32"
    word_order: Order = "big"
    byte_order: Order = "big"

    @property
    def width(self) -> int:
        """How many registers it takes."""
        return width(self.type)

    @property
    def modulus(self) -> int:
        """The number at which it begins at 0 again."""
        return int(2 ** (16 * self.width))

    def decode(self, raw: list[int]) -> int:
        """Returns the number that registers hold.

        Args:
            raw: Its registers.
        """
        return count_from_registers(raw, self.type, self.word_order, self.byte_order)

    def encode(self, number: int) -> list[int]:
        """Returns the registers of a number, less the times that it has begun at 0 again.

        Args:
            number: The number, not negative.
        """
        return to_registers(number % self.modulus, self.type, self.word_order, self.byte_order)


class Ticks(Count):
    """The device's time, from a zero of its own.

    Attributes:
        tick_s: Seconds per unit.
    """

    tick_s: Positive


class Records(Part):
    """Records with a number and a time, the newest first.

    Attributes:
        counter: Number of the record; every further one has one more.
        time: Device time of the record.
        records: How many the device shows.
        stride: Registers from one to the next older one; 0 where it shows one only.
    """

    counter: Count
    time: Ticks
    records: int = Field(default=1, ge=1)
    stride: int = Field(default=0, ge=0)

    @model_validator(mode="after")
    def _has_stride(self) -> "Records":
        if self.records > 1 and not self.stride:
            raise ValueError(f"{self.records} records need a stride, in registers")
        return self

    @property
    def numbers(self) -> tuple[tuple[str, Count], ...]:
        """Counter and time by name."""
        return ("counter", self.counter), ("time", self.time)


class Commands(Records):
    """Commands that the device took, its own among them, as when its watchdog vents.

    Attributes:
        values: Per output the first register of the value that acts from the record's time on; in
            the counter's table, with type, order and scale of the output's channel.
    """

    values: dict[str, int]


class Clock(Part):
    """What a device tells by its own clock.

    Attributes:
        samples: Records of samples; the taps' channels are those of the newest.
        commands: Records of commands; None where it tells none.
    """

    samples: Records
    commands: Commands | None = None

    def sample_span(self, taps: Mapping[str, tuple[str, int, int]]) -> Span:
        """Registers of all records of samples.

        Args:
            taps: Table, first register and width of each.
        """
        places = [(c.address, c.width) for _, c in self.samples.numbers]
        places += [(address, count) for _, address, count in taps.values()]
        return _span(self.samples, places)

    def command_span(self, outputs: Mapping[str, int]) -> Span | None:
        """Registers of all records of commands; None where there are none.

        Args:
            outputs: Width of each in registers.
        """
        if self.commands is None:
            return None
        places = [(c.address, c.width) for _, c in self.commands.numbers]
        places += [(at, outputs[name]) for name, at in self.commands.values.items()]
        return _span(self.commands, places)

    def check_samples(self, taps: Mapping[str, tuple[str, int, int]], most: int) -> None:
        """Checks that a sample comes in one read.

        Args:
            taps: Table, first register and width of each.
            most: Most registers of one read.

        Raises:
            ValueError: It does not.
        """
        if not taps:
            raise ValueError("clock.samples: there is no channel in Pa that is sampled")
        table = self.samples.counter.table
        for name, (at, _, _) in (
            *taps.items(),
            ("clock.samples.time", (self.samples.time.table, 0, 0)),
        ):
            if at != table:
                raise ValueError(
                    f"clock.samples: {name!r} is in table {at} and the counter in table {table}, so"
                    " that no single read has both"
                )
        _check_size("clock.samples", self.samples, self.sample_span(taps), most)

    def check_commands(
        self, outputs: Mapping[str, int], tables: Mapping[str, str], most: int
    ) -> None:
        """Checks that the record of a command is complete and comes in one read.

        Args:
            outputs: Width of each in registers.
            tables: Table of each.
            most: Most registers of one read.

        Raises:
            ValueError: It does not.
        """
        if self.commands is None:
            return
        wrong = sorted(set(self.commands.values) ^ set(outputs))
        if wrong:
            raise ValueError(
                f"clock.commands.values: found {', '.join(self.commands.values) or 'nothing'},"
                f" needed are the outputs {', '.join(outputs)}"
            )
        bits = [name for name, table in tables.items() if table == "coil"]
        if bits:
            raise ValueError(f"clock.commands: output {bits[0]!r} is a coil, which no record holds")
        if self.commands.time.table != self.commands.counter.table:
            raise ValueError("clock.commands: counter and time are in different tables")
        span = self.command_span(outputs)
        assert span is not None
        _check_size("clock.commands", self.commands, span, most)


def _span(records: Records, places: list[tuple[int, int]]) -> Span:
    first = min(address for address, _ in places)
    last = max(address + count for address, count in places)
    count = last - first + (records.records - 1) * records.stride
    return Span(records.counter.table, first, count)


def _check_size(name: str, records: Records, span: Span, most: int) -> None:
    one = span.count - (records.records - 1) * records.stride
    if records.records > 1 and records.stride < one:
        raise ValueError(
            f"{name}: stride {records.stride} is less than the {one} registers of a record"
        )
    if span.count > most:
        raise ValueError(
            f"{name}: {records.records} records take {span.count} registers, one read has at most"
            f" {most}"
        )
    if span.address + span.count > 65536:
        raise ValueError(f"{name}: {records.records} records go beyond the last register")
