# SPDX-License-Identifier: Apache-2.0
"""Parameters of the valve bridge: declared once, with range and description."""

from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from pneu_graph.nodes.common import declare
from pneu_hw_bridge.modbus.bus import LONGEST_TIMEOUT_S
from pneu_hw_bridge.safety.limits import LONGEST_WATCHDOG_S, SAFE_WITHIN_S


@dataclass(frozen=True)
class Settings:
    """Values of the parameters.

    Attributes:
        register_map: File or profile.
        device: Entries of the map's device that are replaced.
        rate_hz: Rate of the bus.
        publish_rate_hz: Rate of the readings' topics.
        timeout_s: Longest wait for an answer.
        watchdog_s: How long a command is followed without a new one.
        sensor_timeout_s: How old a reading may be.
        slew_v_s: Fastest change of a voltage.
        clamp_margin_v: How far beyond its range a command is clamped rather than refused.
        dwell_s: For how long nothing may be wrong before commands are followed again.
        safe_within_s: How soon the valves must be safe at the device.
        commander: The node that may command; empty for any.
        frame_id: Frame of the set of readings.
        publish_clock: Whether the time of the newest sample is published on ``/clock``.
    """

    register_map: str
    device: dict[str, Any]
    rate_hz: float
    publish_rate_hz: float
    timeout_s: float
    watchdog_s: float
    sensor_timeout_s: float
    slew_v_s: float
    clamp_margin_v: float
    dwell_s: float
    safe_within_s: float
    commander: str
    frame_id: str
    publish_clock: bool


def declare_parameters(node: Node) -> None:
    """Declares all parameters.

    Args:
        node: The node.
    """
    declare(
        node,
        "register_map",
        "generic_plc",
        "register map: a YAML file, or a profile (generic_plc, labjack_t)",
    )
    declare(node, "host", "", "Modbus TCP host; empty takes the register map's")
    declare(node, "port", 0, "Modbus TCP port; 0 takes the register map's", (0, 65535))
    declare(node, "serial_port", "", "serial port of Modbus RTU; empty takes the register map's")
    declare(node, "rate_hz", 500.0, "rate at which the device is read and written", (1.0, 1000.0))
    declare(
        node,
        "publish_rate_hz",
        500.0,
        "rate at which readings are published, at most rate_hz",
        (1.0, 1000.0),
    )
    declare(
        node,
        "timeout_s",
        0.1,
        "longest wait for an answer of the device",
        (0.005, LONGEST_TIMEOUT_S),
    )
    declare(
        node,
        "watchdog_s",
        0.1,
        "without a new command for so long the valves vent; must not be 0",
        (0.005, LONGEST_WATCHDOG_S),
    )
    declare(
        node,
        "sensor_timeout_s",
        0.1,
        "with a reading older than this the valves vent",
        (0.005, 1.0),
    )
    declare(
        node,
        "slew_v_s",
        2000.0,
        "fastest change of a voltage while commands are followed",
        (1.0, 1e6),
    )
    declare(
        node,
        "clamp_margin_v",
        1.0,
        "commands out of range by up to so much are clamped, beyond it refused",
        (0.0, 10.0),
    )
    declare(
        node,
        "dwell_s",
        1.0,
        "after anything went wrong commands are followed again once nothing did for so long",
        (0.0, 60.0),
    )
    declare(
        node,
        "safe_within_s",
        SAFE_WITHIN_S,
        "so soon valves must be safe at the device; settings and devices that are slower are"
        " refused, so raise it knowingly",
        (0.05, 60.0),
    )
    declare(
        node,
        "commander",
        "",
        "full name of the node that may command, such as /lab/policy; empty for any one node",
    )
    declare(node, "frame_id", "", "frame_id of taps/pressures")
    declare(
        node,
        "publish_clock",
        False,
        "publish the time of the newest sample on /clock, of a device that keeps time itself",
    )
    declare(
        node,
        "autostart",
        False,
        "configure and activate at the start, where nothing manages the life cycle",
        read_only=True,
    )


def read_parameters(node: Node) -> Settings:
    """Reads all parameters.

    Args:
        node: The node.
    """

    def value(name: str) -> Any:
        return node.get_parameter(name).value

    given = {name: value(name) for name in ("host", "port", "serial_port")}
    return Settings(
        register_map=value("register_map"),
        device={name: one for name, one in given.items() if one},
        rate_hz=value("rate_hz"),
        publish_rate_hz=value("publish_rate_hz"),
        timeout_s=value("timeout_s"),
        watchdog_s=value("watchdog_s"),
        sensor_timeout_s=value("sensor_timeout_s"),
        slew_v_s=value("slew_v_s"),
        clamp_margin_v=value("clamp_margin_v"),
        dwell_s=value("dwell_s"),
        safe_within_s=value("safe_within_s"),
        commander=value("commander"),
        frame_id=value("frame_id"),
        publish_clock=value("publish_clock"),
    )
