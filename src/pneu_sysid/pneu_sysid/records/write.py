# SPDX-License-Identifier: Apache-2.0
"""A recording written back as a rosbag2 MCAP bag."""

from pathlib import Path

from pneu_sim import bag
from pneu_sim.rig.schema import Rig
from pneu_sysid.records.recording import Recording


def write_bag(path: str | Path, rig: Rig, recording: Recording) -> None:
    """Writes a recording as a bag on the topics of its rig, whole or not at all.

    Every signal is written at its own times. Pressures carry header stamps, commands have the log
    time alone. A recording without a clock time begins at ``pneu_sim.bag.FIRST_STAMP_S``, or later
    by as much as a command reaches back.

    Args:
        path: Folder of the bag, or a file that ends in ``.mcap``; must not exist yet.
        rig: Rig whose channels say which topics the signals have.
        recording: The recording.

    Raises:
        InputError: The path exists or cannot be written, or a signal has no topic or a message type
            that is not written.
    """
    bag.write_bag(
        path,
        rig,
        recording.commands,
        recording.pressures,
        recording.start_time_s,
        encoders=recording.encoders,
    )
