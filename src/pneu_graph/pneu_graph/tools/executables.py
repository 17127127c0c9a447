# SPDX-License-Identifier: Apache-2.0
"""Finding the executable of a package: as an entry point, or in an installed ROS workspace."""

import importlib.metadata
import os
from collections.abc import Callable
from pathlib import Path

from pneu_common.children import python
from pneu_common.errors import InputError

GROUP = "pneu.executables"


def entry_points() -> dict[tuple[str, str], importlib.metadata.EntryPoint]:
    """Returns the executables of the installed distributions by package and name."""
    found = {}
    for entry in importlib.metadata.entry_points(group=GROUP):
        package, _, name = entry.name.partition(".")
        found[package, name] = entry
    return found


def load(package: str, name: str) -> Callable[[list[str] | None], None]:
    """Returns the main function of an executable.

    Args:
        package: Such as ``pneu_sim``.
        name: Such as ``simulator``.

    Raises:
        InputError: There is no such executable among the entry points.
    """
    entry = entry_points().get((package, name))
    if entry is None:
        raise _unknown(package, name)
    main: Callable[[list[str] | None], None] = entry.load()
    return main


def command_of(package: str, name: str) -> list[str]:
    """Returns the command line that runs an executable.

    Args:
        package: Such as ``pneu_sim``.
        name: Such as ``simulator``.

    Raises:
        InputError: There is no such executable.
    """
    if (package, name) in entry_points():
        return python("pneu_graph.tools.run", package, name)
    installed = _installed(package, name)
    if installed is None:
        raise _unknown(package, name)
    return [str(installed)]


def _installed(package: str, name: str) -> Path | None:
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix, "lib", package, name)
        if prefix and path.is_file() and os.access(path, os.X_OK):
            return path
    return None


def _unknown(package: str, name: str) -> InputError:
    names = sorted(n for p, n in entry_points() if p == package)
    if names:
        return InputError(
            f"package {package!r} has no executable {name!r}; it has {', '.join(names)}"
        )
    packages = sorted({p for p, _ in entry_points()})
    return InputError(
        f"no executables of package {package!r} are installed; known packages:"
        f" {', '.join(packages) or 'none'}"
    )
