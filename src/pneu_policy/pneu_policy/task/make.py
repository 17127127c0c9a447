# SPDX-License-Identifier: Apache-2.0
"""The tasks that policies are trained on, by what their settings call them."""

from typing import Annotated, Any

from pydantic import Discriminator, Tag

from pneu_policy.task.pushing import Pushing, PushSettings
from pneu_policy.task.robots import Robots, RobotSettings
from pneu_policy.task.task_env import TaskEnv
from pneu_policy.task.tracking import EnvSettings, PressureTracking


def task(value: Any) -> Any:
    """Which task settings are of.

    Args:
        value: They, as plain values or made.
    """
    return value.get("task", "pressure") if isinstance(value, dict) else value.task


TaskSettings = Annotated[
    Annotated[EnvSettings, Tag("pressure")]
    | Annotated[PushSettings, Tag("push")]
    | Annotated[RobotSettings, Tag("robot")],
    Discriminator(task),
]
"""Settings of a task; ``task`` tells which, a pressure's unless given."""


def make_env(settings: EnvSettings | PushSettings | RobotSettings) -> TaskEnv:
    """Builds plants of a task.

    Args:
        settings: What is trained on.

    Raises:
        InputError: A file is missing or wrong, or does not fit the rest.
    """
    if isinstance(settings, PushSettings):
        return Pushing(settings)
    if isinstance(settings, RobotSettings):
        return Robots(settings)
    return PressureTracking(settings)
