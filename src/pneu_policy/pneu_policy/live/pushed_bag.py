# SPDX-License-Identifier: Apache-2.0
"""What a recording of the live graph shows of a thing that was pushed, and of its path."""

from pathlib import Path

import numpy as np

from pneu_common.errors import InputError
from pneu_graph.bag.reader import BagReader
from pneu_policy.judge.pushed import Pushed
from pneu_policy.live.bag import NAMESPACE
from pneu_runtime import hook


def pushed_in(bag: Path, thing: str = "object", namespace: str = NAMESPACE) -> Pushed:
    """What a recording shows of a thing and of its path.

    Args:
        bag: The recording.
        thing: What was pushed.
        namespace: Of the graph.

    Raises:
        InputError: It cannot be read, or lacks one of them.
    """
    hook.install()
    from geometry_msgs.msg import PoseStamped
    from rclpy.serialization import deserialize_message

    topics = [f"/{namespace}/{thing}/{what}" for what in ("pose", "target")]
    found: dict[str, dict[float, tuple[float, float]]] = {topic: {} for topic in topics}
    for message in BagReader(bag).messages(set(topics)):
        told = deserialize_message(message.data, PoseStamped)
        stamp_s = told.header.stamp.sec + 1e-9 * told.header.stamp.nanosec
        found[message.topic][stamp_s] = (told.pose.position.x, told.pose.position.y)
    for topic, messages in found.items():
        if len(messages) < 2:
            raise InputError(f"{bag}: {len(messages)} messages of {topic}, needed are 2 or more")
    poses, targets = (np.array([(t, *xy) for t, xy in sorted(found[k].items())]) for k in topics)
    at_s = targets[:, 0]
    thing_m = np.stack([np.interp(at_s, poses[:, 0], poses[:, k]) for k in (1, 2)], axis=1)
    return Pushed(at_s - at_s[0], thing_m, targets[:, 1:])
