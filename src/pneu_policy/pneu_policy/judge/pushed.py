# SPDX-License-Identifier: Apache-2.0
"""How far off its path a thing is pushed on a plant in its own time.

The plant is that of `pneu_sim.hand.world`, encoders, motors' springs and motion capture included,
and what a policy does takes effect late, as over the graph.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pneu_policy.control.push_policy import PushPolicy
from pneu_policy.control.pusher import Pusher
from pneu_policy.task.push_paths import PushPath
from pneu_sim.hand.drive import JointCommand, Motors
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.truth import Truth
from pneu_sim.hand.world import World

Floats = NDArray[np.float64]

LATE_S = 0.004
"""From readings to torques."""


@dataclass(frozen=True)
class Pushed:
    """Where a thing was, and where it should have been.

    Attributes:
        time_s: (n,) since the path began.
        thing_m: (n, 2) where it was; of a recording, where motion capture saw it.
        path_m: (n, 2) where it should have been.
    """

    time_s: Floats
    thing_m: Floats
    path_m: Floats

    @property
    def rms_m(self) -> float:
        """Root mean square of how far it was off."""
        return float(np.sqrt(np.mean(np.sum((self.thing_m - self.path_m) ** 2, axis=1))))


def push_plant(
    hand: Hand,
    truth: Truth,
    policy: PushPolicy,
    path: PushPath,
    seconds: float,
    thing: str = "object",
    seed: int = 0,
) -> Pushed:
    """Lets a policy push on a plant.

    Args:
        hand: The hand.
        truth: What is hidden of it.
        policy: The policy.
        path: Where the thing shall go.
        seconds: How long.
        thing: What is pushed, a pose of the hand.
        seed: Of the sensors' noise.
    """
    world = World(hand, truth, seed=seed)
    pusher = Pusher(policy, hand, path)
    arms = {name: Motors(list(a.joints.values())) for name, a in hand.settings.arms.items()}
    body = world.model.body(thing).id
    waiting: deque[tuple[float, dict[str, list[JointCommand]]]] = deque()
    command: dict[str, list[JointCommand]] = {}
    seen, rows = np.array(world.data.body(thing).xpos[:2]), []
    due_s = 0.0
    while world.time_s < seconds:
        now_s = world.time_s
        while waiting and waiting[0][0] <= now_s:
            command = waiting.popleft()[1]
        torques = {
            name: motors.drive(world.counts(name), now_s, command.get(name))
            for name, motors in arms.items()
        }
        for reading in world.advance(torques):
            if reading.kind == "pose" and reading.name == thing:
                seen = reading.values[:2]
        if now_s < due_s - 1e-9:
            continue
        due_s += policy.recipe.period_s
        asked = pusher.step(
            now_s,
            np.array([motors.position_rad for motors in arms.values()]),
            np.array([motors.velocity.velocity_rad_s for motors in arms.values()]),
            seen,
        )
        commands = {
            name: [JointCommand(velocity_rad_s=0.0, effort_n_m=float(t)) for t in asked[k]]
            for k, name in enumerate(arms)
        }
        waiting.append((now_s + LATE_S, commands))
        rows.append((now_s, *world.data.xpos[body, :2], *path.at(np.array(now_s))))
    table = np.array(rows)
    return Pushed(table[:, 0], table[:, 1:3], table[:, 3:])
