# SPDX-License-Identifier: Apache-2.0
"""The subcommands of `pneu` about controllers: train, tune, evaluate, policy, and of joints."""

import typer

from pneu_policy.judge.command import register_evaluate
from pneu_policy.judge.joint_command import register_evaluate_joint
from pneu_policy.learn.command import register_train
from pneu_policy.tune.command import register_policy, register_tune
from pneu_policy.tune.joint_command import register_tune_joint


def register(app: typer.Typer) -> None:
    """Adds the subcommands to the application.

    Args:
        app: The application.
    """
    register_train(app)
    register_tune(app)
    register_policy(app)
    register_evaluate(app)
    register_tune_joint(app)
    register_evaluate_joint(app)
