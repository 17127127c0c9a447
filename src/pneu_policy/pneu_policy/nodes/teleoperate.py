# SPDX-License-Identifier: Apache-2.0
"""The teleoperate node: an arm that is led by hand moves another one, whose resistance is felt.

The follower is driven to where the leader is, by the springs and dampers of the hand file, and the
leader, by a share of the same torque, to where the follower is (position to position; thesis
2.6.2). Topics: reads both ``<arm>/joint_states``, gives both ``<arm>/command``. It ends after
``seconds`` of the arms' time, or goes on where that is 0.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.task import Future

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_policy.nodes.arms import Arm, Every, all_heard
from pneu_sim.hand.drive import JointCommand, torque_of
from pneu_sim.hand.paths import eased
from pneu_sim.hand.settings import read_hand

Floats = NDArray[np.float64]

ENGAGE_S = 1.0
"""From where the follower is to where the leader is."""


@dataclass
class TeleoperateParameters(Parameters):
    """What the teleoperate node is told."""

    hand: str = parameter("", "hand file (YAML)", read_only=True)
    leader: str = parameter("leader", "arm that is led by hand", read_only=True)
    follower: str = parameter("phantom", "arm that follows", read_only=True)
    feedback: float = parameter(
        1.0,
        "share of the follower's torque that the leader gives back; 0: nothing is felt",
        within=(0.0, 1.0),
    )
    seconds: float = parameter(0.0, "how long, s; 0: until it is ended", within=(0.0, 3600.0))
    rate_hz: float = parameter(
        500.0, "commands per second of the arms' time", within=(50.0, 2000.0), read_only=True
    )


class TeleoperateNode(Node):
    """The node.

    Attributes:
        done: Set once it has gone on for as long as it was told.
    """

    def __init__(self, **options: Any) -> None:
        """Reads the hand file.

        Args:
            **options: For the node.

        Raises:
            InputError: A parameter or the file is wrong, or the arms are not alike.
        """
        super().__init__("teleoperate", **options)
        self.done: Future = Future()
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        params = self._params = TeleoperateParameters.declare(self)
        if not params.hand:
            raise InputError("parameter hand: found nothing, a hand file is needed")
        arms = read_hand(params.hand).arms
        for role in ("leader", "follower"):
            name = getattr(params, role)
            if name not in arms:
                raise InputError(
                    f"parameter {role}: found {name!r}, {params.hand} has {', '.join(arms)}"
                )
        names = [list(arms[one].joints) for one in (params.leader, params.follower)]
        if params.leader == params.follower or names[0] != names[1]:
            raise InputError(
                f"parameters leader, follower: found {params.leader!r} with {', '.join(names[0])}"
                f" and {params.follower!r} with {', '.join(names[1])}; two arms alike are needed"
            )
        self._springs = list(arms[params.follower].joints.values())
        self._limits = [joint.torque_limit_n_m for joint in arms[params.leader].joints.values()]
        self._begun_s = math.nan
        self._every = Every(params.rate_hz)
        self._from: Floats = np.zeros(len(names[0]))
        self._leader = Arm(self, params.leader, names[0], self._on_readings)
        self._follower = Arm(self, params.follower, names[1], self._on_readings)

    def _on_readings(self, now_s: float, stamp: Any) -> None:
        heard_s = {arm.name: arm.heard_s for arm in (self._leader, self._follower)}
        if not all_heard(self, heard_s, now_s):
            self._begun_s = math.nan  # it engages anew
            return
        if not self._every.due(now_s):
            return
        if math.isnan(self._begun_s):
            self._begun_s, self._from = now_s, self._follower.angles_rad
        self._couple(now_s - self._begun_s, stamp)

    def _couple(self, since_s: float, stamp: Any) -> None:
        leader, follower = self._leader, self._follower
        share = float(eased(np.array(min(since_s / ENGAGE_S, 1.0))))
        wanted = self._from + share * (leader.angles_rad - self._from)
        speed = share * leader.speed_rad_s
        follower.command(stamp, position=wanted.tolist(), velocity=speed.tolist())
        gain = share * self._params.feedback
        torques = [
            gain
            * torque_of(
                joint,
                JointCommand(float(follower.angles_rad[k]), float(follower.speed_rad_s[k])),
                float(leader.angles_rad[k]),
                float(leader.speed_rad_s[k]),
            )
            for k, joint in enumerate(self._springs)
        ]
        pairs = zip(torques, self._limits, strict=True)
        leader.command(stamp, effort=[min(max(torque, -most), most) for torque, most in pairs])
        seconds = self._params.seconds
        if seconds and since_s > seconds and not self.done.done():
            self.done.set_result(True)  # and the node ends


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(TeleoperateNode, args)


if __name__ == "__main__":
    main()
