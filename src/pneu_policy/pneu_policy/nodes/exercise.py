# SPDX-License-Identifier: Apache-2.0
"""The exercise node: an arm taps and presses what is in front of it, for a recording.

The path is the same for the same seed, and goes by the time that the arm's readings are stamped
with: an emulated arm that stands still on a busy machine is waited for. The node ends when it has
gone all of it. Topics: reads ``<arm>/joint_states``, gives ``<arm>/command``.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.task import Future

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_policy.nodes.arms import Arm, Every
from pneu_sim.hand.exercise import exercise
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import Kinematics, eased

APPROACH_S = 1.0
"""From where the arm is to where its path begins."""
REST_S = 0.3
"""At rest, before the path and after it."""


@dataclass
class ExerciseParameters(Parameters):
    """What the exercise node is told."""

    hand: str = parameter("", "hand file (YAML)", read_only=True)
    arm: str = parameter("", "arm of the hand file; empty for its only one", read_only=True)
    tip: str = parameter("", "geom of the tip; empty: ARM_tip", read_only=True)
    thing: str = parameter("object", "geom that is touched", read_only=True)
    seconds: float = parameter(10.0, "how long, s", within=(1.0, 600.0), read_only=True)
    seed: int = parameter(0, "seed of the path", within=(0, 2**31 - 1), read_only=True)
    rate_hz: float = parameter(
        500.0, "commands per second of the arm's time", within=(50.0, 2000.0), read_only=True
    )


class ExerciseNode(Node):
    """The node.

    Attributes:
        done: Set once all of the path was gone.
    """

    def __init__(self, **options: Any) -> None:
        """Plans the path.

        Args:
            **options: For the node.

        Raises:
            InputError: A parameter or a file is wrong, or the thing cannot be reached.
        """
        super().__init__("exercise", **options)
        self.done: Future = Future()
        try:
            params = ExerciseParameters.declare(self)
            if not params.hand:
                raise InputError("hand: found nothing, a hand file is needed")
            hand = Hand(params.hand)
            arms = hand.settings.arms
            arm = params.arm or (next(iter(arms)) if len(arms) == 1 else "")
            if arm not in arms:
                raise InputError(f"arm: found {arm!r}, {params.hand} has {', '.join(arms)}")
            tip = params.tip or f"{arm}_tip"
            self._path = exercise(
                hand, Kinematics(hand, arm, tip), tip, params.thing, params.seconds, params.seed
            )
        except InputError:
            self.destroy_node()
            raise
        self._begun_s = math.nan
        self._from = self._path.angles_rad[0]
        self._every = Every(params.rate_hz)
        self._arm = Arm(self, arm, list(arms[arm].joints), self._on_readings)

    def _on_readings(self, now_s: float, stamp: Any) -> None:
        if not self._every.due(now_s):
            return
        if math.isnan(self._begun_s):
            self._begun_s, self._from = now_s, self._arm.angles_rad
        since_s = now_s - self._begun_s
        begin = self._path.angles_rad[0]
        if since_s < APPROACH_S:
            share = eased(np.array(since_s / APPROACH_S))
            angles, velocity = self._from + share * (begin - self._from), np.zeros(len(begin))
        else:
            angles, velocity = self._path.at(since_s - APPROACH_S - REST_S)
        self._arm.command(stamp, position=angles.tolist(), velocity=velocity.tolist())
        if since_s > APPROACH_S + float(self._path.time_s[-1]) + 2.0 * REST_S:
            self.done.set_result(True)  # and the node ends


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(ExerciseNode, args)


if __name__ == "__main__":
    main()
