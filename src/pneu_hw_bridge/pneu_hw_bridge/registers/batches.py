# SPDX-License-Identifier: Apache-2.0
"""Channels put together so that few requests carry them: neighbours in one read or write."""

from collections.abc import Mapping
from dataclasses import dataclass

from pneu_hw_bridge.registers.schema import Batching, ChannelBase, Table

MAX_BITS = 2000
"""Most bits that one read may ask for, by the Modbus application protocol 1.1b3, 6.1."""


@dataclass(frozen=True)
class Batch:
    """Registers, or bits, that one request carries.

    Attributes:
        table: Modbus table.
        address: First register or bit.
        count: How many.
        channels: Channels within, by name.
    """

    table: Table
    address: int
    count: int
    channels: tuple[tuple[str, ChannelBase], ...]

    def decode(self, raw: list[int]) -> dict[str, float]:
        """Returns the SI value of each channel.

        Args:
            raw: The registers or bits, ``count`` of them.
        """
        values = {}
        for name, channel in self.channels:
            start = channel.address - self.address
            values[name] = channel.decode(raw[start : start + channel.width])
        return values

    def encode(self, values: Mapping[str, float]) -> list[int]:
        """Returns registers or bits that hold a value for each channel.

        Args:
            values: SI value of each channel.
        """
        raw = [0] * self.count
        for name, channel in self.channels:
            start = channel.address - self.address
            raw[start : start + channel.width] = channel.encode(values[name])
        return raw


def plan(channels: Mapping[str, ChannelBase], batching: Batching) -> list[Batch]:
    """Puts channels together for reading.

    Args:
        channels: The channels by name.
        batching: How large requests may be, and which gaps are read along.
    """
    batches: list[Batch] = []
    ordered = sorted(channels.items(), key=lambda item: (item[1].table, item[1].address))
    for name, channel in ordered:
        end = channel.address + channel.width
        last = batches[-1] if batches else None
        if last is not None and last.table == channel.table:
            limit = MAX_BITS if channel.is_bit else batching.max_registers
            gap = channel.address - (last.address + last.count)
            count = end - last.address
            if gap <= batching.max_gap and count <= limit:
                batches[-1] = Batch(
                    last.table, last.address, count, (*last.channels, (name, channel))
                )
                continue
        batches.append(Batch(channel.table, channel.address, channel.width, ((name, channel),)))
    return batches


def plan_writes(channels: Mapping[str, ChannelBase]) -> list[Batch]:
    """Puts channels together for writing; what no channel uses is never written.

    Args:
        channels: The channels by name.
    """
    return plan(channels, Batching(max_registers=120, max_gap=0))
