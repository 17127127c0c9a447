# SPDX-License-Identifier: Apache-2.0
"""Trainings of a study: what is there is kept, and one that fails fails the study."""

import argparse
import os
from collections.abc import Sequence

from pneu_common.errors import InputError
from pneu_common.progress import progress
from pneu_policy.learn.sweep import BACKENDS, Run, Workers, train_all


def add_workers(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments ``workers`` and ``backend``.

    Args:
        parser: Of the study.
    """
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--backend", choices=BACKENDS, default=BACKENDS[0])


def train_runs(runs: Sequence[Run], workers: Workers) -> None:
    """Trains what is not trained yet.

    Args:
        runs: The trainings.
        workers: Where.

    Raises:
        InputError: Some failed; the others were trained all the same.
    """
    failed = []
    with progress(f"training {len(runs)} policies") as tell:
        for done, outcome in enumerate(train_all(runs, workers), 1):
            told = str(outcome.run.folder)
            if outcome.fault:
                told += f": {outcome.fault}"
                failed.append(told)
            tell("policies", done / len(runs), told)
    if failed:
        raise InputError("; ".join(failed))
