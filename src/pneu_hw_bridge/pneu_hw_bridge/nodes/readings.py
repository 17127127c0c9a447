# SPDX-License-Identifier: Apache-2.0
"""Publishing readings: every tap on its own topic, and all of them as a set."""

import math

from pneu_msgs.msg import TapPressures
from rclpy.node import Node
from sensor_msgs.msg import FluidPressure

from pneu_hw_bridge.link import Sample
from pneu_hw_bridge.registers.schema import Input
from pneu_sim.nodes.common import READINGS_QOS, to_stamp


class ReadingsPublisher:
    """Publishers of all taps; readings that cannot be true are left out, NaN in the set."""

    def __init__(self, node: Node, taps: dict[str, Input], frame_id: str) -> None:
        """Creates the publishers.

        Args:
            node: The node.
            taps: The taps by name.
            frame_id: Frame of the set.
        """
        self._node = node
        self._taps = taps
        self._set = TapPressures(name=list(taps))
        self._set.header.frame_id = frame_id
        self._one = FluidPressure()
        self._to_set = node.create_publisher(TapPressures, "taps/pressures", READINGS_QOS)
        self._to_one = {
            name: node.create_publisher(FluidPressure, f"taps/{name}/pressure", READINGS_QOS)
            for name in taps
        }

    def publish(self, sample: Sample) -> None:
        """Publishes one sample.

        Args:
            sample: What was read.
        """
        stamp = to_stamp(sample.stamp_ns)
        pressures = []
        for name, channel in self._taps.items():
            value = sample.values[name]
            if not channel.range[0] <= value <= channel.range[1]:  # true for NaN
                pressures.append(math.nan)
                continue
            pressures.append(value)
            self._one.header.stamp = stamp
            self._one.header.frame_id = name
            self._one.fluid_pressure = value
            self._to_one[name].publish(self._one)
        self._set.header.stamp = stamp
        self._set.pressure_pa = pressures
        self._to_set.publish(self._set)

    def destroy(self) -> None:
        """Destroys the publishers."""
        for publisher in (self._to_set, *self._to_one.values()):
            self._node.destroy_publisher(publisher)
