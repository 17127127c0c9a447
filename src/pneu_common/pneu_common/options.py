# SPDX-License-Identifier: Apache-2.0
"""What options of several commands have in common."""

from typing import Annotated

import typer

MOST_SEED = 2**31 - 1
"""Largest seed; what draws from one takes no larger everywhere."""

Force = Annotated[
    bool, typer.Option("--force", help="Replace files that exist and are no results of pneu.")
]
