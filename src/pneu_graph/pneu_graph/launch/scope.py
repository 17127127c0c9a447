# SPDX-License-Identifier: Apache-2.0
"""What holds where an action of a launch file stands: arguments, environment, namespace, remaps."""

import dataclasses
from pathlib import Path
from typing import Any


@dataclasses.dataclass
class Scope:
    """State while a launch file is carried out.

    Attributes:
        configurations: Values of arguments and of `let`.
        environment: Environment of the processes.
        path: The launch file.
        namespace: Namespace that is pushed.
        parameters: What `set_parameter` has set, in order.
        remaps: What `set_remap` has set, in order.
        anonymous: Names made by ``$(anon ...)``.
        delay_s: Of the timers around, s.
        depth: Of inclusion.
    """

    configurations: dict[str, str]
    environment: dict[str, str]
    path: Path
    namespace: str = ""
    parameters: list[tuple[str, Any]] = dataclasses.field(default_factory=list)
    remaps: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    anonymous: dict[str, str] = dataclasses.field(default_factory=dict)
    delay_s: float = 0.0
    depth: int = 0

    def inner(self) -> "Scope":
        """Returns a copy for a group."""
        return dataclasses.replace(
            self,
            configurations=dict(self.configurations),
            environment=dict(self.environment),
            parameters=list(self.parameters),
            remaps=list(self.remaps),
        )
