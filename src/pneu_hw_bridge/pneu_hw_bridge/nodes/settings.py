# SPDX-License-Identifier: Apache-2.0
"""Parameters of the valve bridge, with range and description."""

from dataclasses import dataclass
from typing import Any

from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_hw_bridge.modbus.bus import LONGEST_TIMEOUT_S
from pneu_hw_bridge.safety.limits import LONGEST_WATCHDOG_S, SAFE_WITHIN_S


@dataclass
class BridgeParameters(Parameters):
    """What the valve bridge is told."""

    register_map: str = parameter(
        "generic_plc", "register map: a YAML file, or a profile such as generic_plc"
    )
    rig: str = parameter(
        "",
        "rig file of what is behind the device; its channels say on which topics commands and taps"
        " are; empty: valve/command and taps/<tap>/pressure",
    )
    host: str = parameter("", "Modbus TCP host; empty takes the register map's")
    port: int = parameter(0, "Modbus TCP port; 0 takes the register map's", within=(0, 65535))
    serial_port: str = parameter("", "serial port of Modbus RTU; empty takes the register map's")
    rate_hz: float = parameter(
        500.0, "rate at which the device is read and written", within=(1.0, 1000.0)
    )
    publish_rate_hz: float = parameter(
        500.0, "rate at which readings are published, at most rate_hz", within=(1.0, 1000.0)
    )
    timeout_s: float = parameter(
        0.1, "longest wait for an answer of the device", within=(0.005, LONGEST_TIMEOUT_S)
    )
    watchdog_s: float = parameter(
        0.1,
        "without a new command for so long the valves vent; must not be 0",
        within=(0.005, LONGEST_WATCHDOG_S),
    )
    sensor_timeout_s: float = parameter(
        0.1, "with a reading older than this the valves vent", within=(0.005, 1.0)
    )
    slew_v_s: float = parameter(
        2000.0, "fastest change of a voltage while commands are followed", within=(1.0, 1e6)
    )
    clamp_margin_v: float = parameter(
        1.0,
        "commands out of range by up to so much are clamped, beyond it refused",
        within=(0.0, 10.0),
    )
    dwell_s: float = parameter(
        1.0,
        "after anything went wrong commands are followed again once nothing did for so long",
        within=(0.0, 60.0),
    )
    safe_within_s: float = parameter(
        SAFE_WITHIN_S,
        "so soon valves must be safe at the device; settings and devices that are slower are"
        " refused, so raise it knowingly",
        within=(0.05, 60.0),
    )
    commander: str = parameter(
        "",
        "full name of the node that may command, such as /lab/policy; empty for any one node",
    )
    frame_id: str = parameter("", "frame_id of taps/pressures")
    publish_clock: bool = parameter(
        False,
        "publish the time of the newest sample on /clock, of a device that keeps time itself",
    )
    autostart: bool = parameter(
        False,
        "configure and activate at the start, where nothing manages the life cycle",
        read_only=True,
    )

    @property
    def device(self) -> dict[str, Any]:
        """Entries of the register map's device that are replaced."""
        given = {"host": self.host, "port": self.port, "serial_port": self.serial_port}
        return {name: one for name, one in given.items() if one}
