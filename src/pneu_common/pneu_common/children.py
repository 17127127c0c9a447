# SPDX-License-Identifier: Apache-2.0
"""Child processes that run nothing but what is installed.

Python looks for modules in the working folder first where it is started with ``-m``. Recordings and
rigs that somebody received lie there, and a file of theirs may be called ``numpy.py``.
"""

import os
import sys

PATHS = "PYTHONPATH"


def python(module: str, *words: str) -> list[str]:
    """Return the command line that runs a module, not looked for in the working folder.

    Args:
        module: Its name.
        *words: Its arguments.
    """
    return [sys.executable, "-P", "-m", module, *words]


def keep_to_installed() -> None:
    """Take places relative to the working folder, and empty ones, out of ``PYTHONPATH``."""
    if given := os.environ.get(PATHS):
        kept = [path for path in given.split(os.pathsep) if os.path.isabs(path)]
        os.environ[PATHS] = os.pathsep.join(kept)
