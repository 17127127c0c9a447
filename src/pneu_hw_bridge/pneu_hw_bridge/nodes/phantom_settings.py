# SPDX-License-Identifier: Apache-2.0
"""Parameters of the Phantom bridge, with range and description."""

from dataclasses import dataclass

from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_hw_bridge.phantom import rdt
from pneu_hw_bridge.phantom.openhaptics import LIBRARY


@dataclass
class PhantomParameters(Parameters):
    """What the bridge is told."""

    hand: str = parameter("", "hand file (YAML)")
    arm: str = parameter("", "arm of the hand file; empty for its only one")
    device: str = parameter(
        "openhaptics:",
        "emulated:SOCKET, or openhaptics:NAME with the device's name in the driver's configuration,"
        " empty for the default one",
    )
    library: str = parameter(LIBRARY, "OpenHaptics' library, path or name")
    rate_hz: float = parameter(2000.0, "rate of the loop", within=(100.0, 4000.0))
    publish_rate_hz: float = parameter(
        1000.0, "rate at which joint_states are published, at most rate_hz", within=(1.0, 4000.0)
    )
    watchdog_s: float = parameter(
        0.05, "without a new command for so long torques end", within=(0.002, 1.0)
    )
    device_timeout_s: float = parameter(
        0.005, "without a new frame of the device for so long torques end", within=(0.001, 0.1)
    )
    sensor_timeout_s: float = parameter(
        0.008,
        "without a new record of the force sensor for so long torques end",
        within=(0.001, 0.1),
    )
    dwell_s: float = parameter(
        0.5,
        "after anything went wrong commands are followed again once nothing did for so long",
        within=(0.0, 60.0),
    )
    net_ft_host: str = parameter("", "address of the Net F/T box; empty where the arm has none")
    net_ft_port: int = parameter(rdt.PORT, "its UDP port", within=(1, 65535))
    net_ft_web_port: int = parameter(80, "port of its page of settings", within=(1, 65535))
    wait_s: float = parameter(
        10.0, "how long device and force sensor are waited for at the start", within=(0.0, 600.0)
    )
    commander: str = parameter(
        "", "full name of the node that may command, such as /lab/reach; empty for any one node"
    )
    frame_id: str = parameter("", "frame_id of the wrench; empty for ARM_wrench")
    autostart: bool = parameter(
        False,
        "configure and activate at the start, where nothing manages the life cycle",
        read_only=True,
    )
