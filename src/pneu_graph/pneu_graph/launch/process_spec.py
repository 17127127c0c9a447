# SPDX-License-Identifier: Apache-2.0
"""What is known of a process before it starts."""

import dataclasses

SIGTERM_TIMEOUT_S = 5.0
SIGKILL_TIMEOUT_S = 5.0


@dataclasses.dataclass
class ProcessSpec:
    """A process of a launch file.

    Attributes:
        label: Prefix of its output, such as ``simulator-1``.
        command: The command line.
        environment: Its environment.
        directory: Its working directory; None: that of the launch.
        screen: Streams that are shown, of ``stdout`` and ``stderr``.
        shell: Whether a shell runs the command.
        delay_s: Time after the start of the launch, s.
        respawn: Whether it starts again when it ends.
        respawn_delay_s: Pause before that, s.
        respawn_max_retries: How often; negative: without limit.
        shutdown_on_exit: Whether everything ends when it ends.
        sigterm_timeout_s: Time from SIGINT to SIGTERM, s.
        sigkill_timeout_s: Time from SIGTERM to SIGKILL, s.
    """

    label: str
    command: list[str]
    environment: dict[str, str]
    directory: str | None = None
    screen: frozenset[str] = frozenset({"stderr"})
    shell: bool = False
    delay_s: float = 0.0
    respawn: bool = False
    respawn_delay_s: float = 0.0
    respawn_max_retries: int = -1
    shutdown_on_exit: bool = False
    sigterm_timeout_s: float = SIGTERM_TIMEOUT_S
    sigkill_timeout_s: float = SIGKILL_TIMEOUT_S
