# SPDX-License-Identifier: Apache-2.0
"""The packages of the repository, from the floor upwards: each may import those before it."""

import os
from pathlib import Path

PACKAGES = (
    "pneu_common",
    "pneu_runtime",
    "pneu_graph",
    "pneu_sim",
    "pneu_hw_bridge",
    "pneu_sysid",
    "pneu_policy",
    "pneu_workbench",
)


def python_path(folder: str | Path) -> str:
    """PYTHONPATH for a program: a folder, then what is there, which may name other sources."""
    return os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
