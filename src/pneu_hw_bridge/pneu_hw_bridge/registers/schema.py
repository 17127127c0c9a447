# SPDX-License-Identifier: Apache-2.0
"""What a register map may say: the device, and per channel its place, form, scale and limits.

Written values and readings are in SI units at the valve or the sensor; ``si = raw * scale +
offset`` converts, whatever amplifiers or transducers lie between.
"""

import math
from collections.abc import Iterator
from typing import Annotated, Literal

from pydantic import Field, model_validator

from pneu_hw_bridge.registers.clock import Clock, Span
from pneu_hw_bridge.registers.codec import NumberType, Order, from_registers, to_registers, width
from pneu_hw_bridge.registers.part import MAX_READ_REGISTERS, Finite, Part, Positive

SCHEMA_VERSION = 1

Table = Literal["holding", "input", "coil", "discrete"]


class Device(Part):
    """Where the device is reached.

    Attributes:
        transport: ``tcp``, or ``rtu`` on a serial line.
        host: Name or address of a TCP device.
        port: Its TCP port.
        serial_port: Serial port of an RTU device.
        baud_rate: Its speed, bit/s.
        parity: ``N`` none, ``E`` even, ``O`` odd.
        stop_bits: Stop bits.
        unit: Modbus unit (slave) address.
        connections: How many of the device's TCP connections the bridge may use: with two a command
            never waits for a reading. Where the device serves one only, one is used.
        watchdog_s: After how long without a write the device itself goes to its safe state, s; None
            where it does not.
    """

    transport: Literal["tcp", "rtu"] = "tcp"
    host: str = "127.0.0.1"
    port: int = Field(default=502, ge=1, le=65535)
    serial_port: str = "/dev/ttyUSB0"
    baud_rate: int = Field(default=115200, ge=1200)
    parity: Literal["N", "E", "O"] = "E"
    stop_bits: Literal[1, 2] = 1
    unit: int = Field(default=1, ge=0, le=247)
    connections: Literal[1, 2] = 2
    watchdog_s: Positive | None = None

    @property
    def where(self) -> str:
        """Where it is reached, for people and to compare."""
        if self.transport == "tcp":
            return f"{self.host}:{self.port} unit {self.unit}"
        return f"{self.serial_port} unit {self.unit}"


class Batching(Part):
    """How adjacent registers are read together.

    Attributes:
        max_registers: Most registers in one read.
        max_gap: Unused registers between two channels that are read along rather than split; 0 for
            devices that refuse to read what they do not define.
    """

    max_registers: int = Field(default=MAX_READ_REGISTERS, ge=4, le=MAX_READ_REGISTERS)
    max_gap: int = Field(default=8, ge=0, le=MAX_READ_REGISTERS)


class ChannelBase(Part):
    """What every channel says.

    Attributes:
        table: Modbus table: ``holding``, ``input``, ``coil`` or ``discrete``.
        address: First register or bit, counted from 0 as on the wire.
        type: Type of the number; None on a coil or discrete input.
        word_order: ``big`` where the most significant register comes first.
        byte_order: ``big`` where the most significant byte of a register comes first.
        scale: SI units per raw unit.
        offset: SI value at raw zero.
        unit: SI unit.
        range: Lowest and highest valid value, SI.
    """

    table: Table
    address: int = Field(ge=0, le=65535)
    type: NumberType | None = None
    word_order: Order = "big"
    byte_order: Order = "big"
    scale: Finite = 1.0
    offset: Finite = 0.0
    unit: str
    range: tuple[Finite, Finite]

    @model_validator(mode="after")
    def _consistent(self) -> "ChannelBase":
        if self.is_bit != (self.type is None):
            raise ValueError(
                "a coil or discrete input has no type"
                if self.is_bit
                else f"a channel in table {self.table} needs a type"
            )
        if self.scale == 0.0:
            raise ValueError("scale must not be 0")
        if self.address + self.width > 65536:
            raise ValueError(f"address {self.address} leaves no room for {self.type}")
        if not self.range[0] < self.range[1]:
            raise ValueError(f"range {list(self.range)} must increase")
        return self

    @property
    def is_bit(self) -> bool:
        """Whether the channel is a single bit."""
        return self.table in ("coil", "discrete")

    @property
    def width(self) -> int:
        """How many registers, or bits, the channel takes."""
        return 1 if self.type is None else width(self.type)

    def decode(self, raw: list[int]) -> float:
        """Returns the SI value that registers or a bit hold; may be infinite or not a number.

        Args:
            raw: The channel's registers or its bit.
        """
        number = (
            float(raw[0])
            if self.type is None
            else from_registers(raw, self.type, self.word_order, self.byte_order)
        )
        return number * self.scale + self.offset

    def encode(self, value: float) -> list[int]:
        """Returns the registers or the bit for an SI value.

        Args:
            value: The value.

        Raises:
            ValueError: The channel's type cannot hold it.
        """
        raw = (value - self.offset) / self.scale
        if self.type is None:
            if not math.isfinite(raw):
                raise ValueError(f"{value!r} cannot be sent as a bit")
            return [int(raw >= 0.5)]
        return to_registers(raw, self.type, self.word_order, self.byte_order)

    @property
    def resolution(self) -> float:
        """Largest error that sending a value through the registers makes, SI."""
        if self.type == "float64":
            return 1e-12 * max(abs(self.range[0]), abs(self.range[1]), abs(self.scale))
        if self.type == "float32":
            return 2.0**-22 * max(abs(self.range[0]), abs(self.range[1]), abs(self.offset))
        return 0.51 * abs(self.scale)  # (rounded; and a bit that is on is not off)


class Output(ChannelBase):
    """A valve command.

    Attributes:
        direction: ``write``.
        safe: What is written to be safe: the voltage that vents.
    """

    direction: Literal["write"]
    unit: Literal["V"] = "V"
    safe: Finite

    @model_validator(mode="after")
    def _writable(self) -> "Output":
        if self.table not in ("holding", "coil"):
            raise ValueError(f"a command cannot be written to table {self.table}")
        if not self.range[0] <= self.safe <= self.range[1]:
            raise ValueError(f"safe {self.safe} lies outside of range {list(self.range)}")
        for value in (*self.range, self.safe):
            self.encode(value)
        return self


class Input(ChannelBase):
    """A pressure sensor, or another quantity of the device that is only shown.

    Attributes:
        direction: ``read``.
        unit: ``Pa`` (absolute) makes it a tap; others are shown in the diagnostics.
        trip_above: Reading above which the bridge vents and stays so until it is reset, SI.
        hold_below: Reading below which the bridge vents until it has risen again (loss of supply).
        frozen_after_s: For how long a reading may stay bit for bit the same, s; None is for ever.
            Only for sensors whose noise exceeds their resolution.
    """

    direction: Literal["read"]
    trip_above: Finite | None = None
    hold_below: Finite | None = None
    frozen_after_s: Positive | None = None

    @model_validator(mode="after")
    def _limits(self) -> "Input":
        for name in ("trip_above", "hold_below"):
            limit = getattr(self, name)
            if limit is not None and not self.range[0] <= limit <= self.range[1]:
                raise ValueError(f"{name} {limit} lies outside of range {list(self.range)}")
        return self


class Frozen(Part):
    """When an encoder that keeps its reading must be broken: the gas pushes, and nothing moves.

    At rest gas can push no more than friction and load hold. Where it pushes with more, and not
    into a stop, what it pushes moves.

    Attributes:
        force: Taps that push, each with its area, m^2 (a torque is given as m^3): positive where
            its pressure raises the encoder's reading.
        hold: The most that friction and load hold at rest, N, or N m where areas are m^3.
        offset: What pushes besides, such as the room's pressure on a rod, N or N m.
        after_s: For how long that may last.
        still: What counts as no movement, SI; None is the encoder's resolution.
        stops: Lowest and highest position that the joint can have, SI; None is the rig file's.
    """

    force: dict[str, Finite] = Field(min_length=1)
    hold: Positive
    offset: Finite = 0.0
    after_s: Positive = 0.05
    still: Positive | None = None
    stops: tuple[Finite, Finite] | None = None


class Encoder(ChannelBase):
    """A position sensor of a joint or piston.

    Attributes:
        unit: ``rad`` or ``m``.
        wrap: Raw counts after which the register begins anew, such as those of a turn; None where
            it never does.
        lower: Position below which the bridge trips; None is the lower stop in the rig file, with a
            twentieth of the joint's travel more, where there is one.
        upper: Position above which it trips, likewise.
        speed_limit: Speed above which it trips, SI per second, told over 40 ms.
        impossible: Speed that cannot be, SI per second: two readings that are further apart than it
            allows are a jump, and trip.
        frozen: When it trips because the reading stays as it is; None is never.
    """

    unit: Literal["rad", "m"]
    wrap: Positive | None = None
    lower: Finite | None = None
    upper: Finite | None = None
    speed_limit: Positive | None = None
    impossible: Positive | None = None
    frozen: Frozen | None = None

    @model_validator(mode="after")
    def _limited(self) -> "Encoder":
        if self.is_bit:
            raise ValueError(f"table {self.table}: an encoder needs a register, not a bit")
        low, high = self.range
        for name in ("lower", "upper"):
            limit = getattr(self, name)
            if limit is not None and not low <= limit <= high:
                raise ValueError(f"{name} {limit} lies outside of range {list(self.range)}")
        if self.lower is not None and self.upper is not None and not self.lower < self.upper:
            raise ValueError(f"lower {self.lower} must be less than upper {self.upper}")
        return self

    @property
    def turn(self) -> float:
        """Way after which the register begins anew, SI; infinite where it never does."""
        return math.inf if self.wrap is None else self.wrap * abs(self.scale)


Channel = Annotated[Output | Input, Field(discriminator="direction")]


class Setting(Part):
    """A register that is written once whenever the connection comes up.

    Attributes:
        table: ``holding`` or ``coil``.
        address: First register or bit.
        type: Type of the number; None on a coil.
        word_order: ``big`` where the most significant register comes first.
        byte_order: ``big`` where the most significant byte of a register comes first.
        value: Raw value.
        comment: What it does.
    """

    table: Literal["holding", "coil"] = "holding"
    address: int = Field(ge=0, le=65535)
    type: NumberType | None = None
    word_order: Order = "big"
    byte_order: Order = "big"
    value: Finite
    comment: str = ""

    @model_validator(mode="after")
    def _encodes(self) -> "Setting":
        if (self.table == "coil") != (self.type is None):
            raise ValueError("a setting needs a type, but on a coil")
        self.encode()
        return self

    def encode(self) -> list[int]:
        """Returns the registers or the bit to write."""
        if self.type is None:
            return [int(self.value != 0.0)]
        return to_registers(self.value, self.type, self.word_order, self.byte_order)


class RegisterMap(Part):
    """A device and its channels.

    Attributes:
        pneu_registers: Version of this schema.
        name: Name.
        description: What it is, for people.
        device: Where it is reached.
        batching: How adjacent registers are read together.
        settings: What is written whenever the connection comes up.
        channels: Channels, by the names that commands and taps have in the rig file.
        encoders: Position sensors, by the names that they have in the rig file.
        clock: Where the device tells by its own clock when it took samples and commands; None where
            it does not.
    """

    pneu_registers: Literal[1]
    name: str
    description: str = ""
    device: Device = Device()
    batching: Batching = Batching()
    settings: tuple[Setting, ...] = ()
    channels: dict[str, Channel] = Field(min_length=1)
    encoders: dict[str, Encoder] = Field(default_factory=dict)
    clock: Clock | None = None

    @model_validator(mode="after")
    def _in_one_read(self) -> "RegisterMap":
        if self.clock is None:
            return self
        self.clock.check_samples(
            {name: (one.table, one.address, one.width) for name, one in self.sampled.items()},
            self.batching.max_registers,
        )
        self.clock.check_commands(
            {name: output.width for name, output in self.outputs.items()},
            {name: output.table for name, output in self.outputs.items()},
            self.batching.max_registers,
        )
        return self

    @model_validator(mode="after")
    def _pushed(self) -> "RegisterMap":
        for name, encoder in self.encoders.items():
            if name in self.channels:
                raise ValueError(f"encoders: {name!r} is the name of a channel already")
            for tap in encoder.frozen.force if encoder.frozen is not None else ():
                if tap not in self.taps:
                    raise ValueError(
                        f"encoders.{name}.frozen.force: {tap!r} is not among taps"
                        f" ({', '.join(self.taps) or 'none'})"
                    )
        return self

    @model_validator(mode="after")
    def _apart(self) -> "RegisterMap":
        if not self.outputs:
            raise ValueError("channels: none has direction write, so there is nothing to command")
        taken: dict[tuple[str, int], str] = {}
        for name, table, address, count in self._places():
            for at in range(address, address + count):
                other = taken.setdefault((table, at), name)
                if other != name:
                    raise ValueError(f"channels: {name!r} and {other!r} both use {table} {at}")
        return self

    def _places(self) -> Iterator[tuple[str, str, int, int]]:
        """Name, table, first register and width of all that has a place."""
        for name, channel in self.places.items():
            yield name, channel.table, channel.address, channel.width
        if self.clock is None:
            return
        samples, commands = self.clock.samples, self.clock.commands
        places: list[tuple[str, str, int, int]]
        places = [("clock.samples." + n, c.table, c.address, c.width) for n, c in samples.numbers]
        yield from places
        # Records beyond the first lie a stride further each, the sensors in them as well.
        places += [(n, one.table, one.address, one.width) for n, one in self.sampled.items()]
        for record in range(1, samples.records):
            for name, table, address, count in places:
                yield f"{name} of record {record}", table, address + record * samples.stride, count
        if commands is None:
            return
        places = [("clock.commands." + n, c.table, c.address, c.width) for n, c in commands.numbers]
        for name, address in commands.values.items():
            count = self.outputs[name].width
            places.append((f"clock.commands.values.{name}", commands.counter.table, address, count))
        for record in range(commands.records):
            told = f" of record {record}" if record else ""
            for name, table, address, count in places:
                yield f"{name}{told}", table, address + record * commands.stride, count

    @property
    def sample_span(self) -> Span | None:
        """Registers of all records of samples; None where the device has no clock."""
        if self.clock is None:
            return None
        return self.clock.sample_span(
            {name: (one.table, one.address, one.width) for name, one in self.sampled.items()}
        )

    @property
    def command_span(self) -> Span | None:
        """Registers of all records of commands; None where there are none."""
        if self.clock is None:
            return None
        return self.clock.command_span({n: output.width for n, output in self.outputs.items()})

    @property
    def outputs(self) -> dict[str, Output]:
        """Channels that are written."""
        return {n: c for n, c in self.channels.items() if isinstance(c, Output)}

    @property
    def places(self) -> dict[str, ChannelBase]:
        """Channels and encoders: all that has registers of its own, by name."""
        return {**self.channels, **self.encoders}

    @property
    def inputs(self) -> dict[str, Input]:
        """Channels that are read, but for encoders."""
        return {n: c for n, c in self.channels.items() if isinstance(c, Input)}

    @property
    def taps(self) -> dict[str, Input]:
        """Channels that are pressure sensors."""
        return {n: c for n, c in self.inputs.items() if c.unit == "Pa"}

    @property
    def sampled(self) -> dict[str, Input | Encoder]:
        """Taps and encoders: what a device with a clock samples together."""
        return {**self.taps, **self.encoders}
