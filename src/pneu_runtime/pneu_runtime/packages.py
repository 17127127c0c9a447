# SPDX-License-Identifier: Apache-2.0
"""Find installed packages, with or without the resource index of ament.

Packages of ROS workspaces are found below the prefixes of AMENT_PREFIX_PATH. After them come the
packages of source trees (folders with a `package.xml`): those that PNEU_PACKAGE_PATH names, and the
checkout or the data folder of the wheel that this installation came from.
"""

import functools
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from pneu_common.installed import own_tree

PREFIX_PATH = "AMENT_PREFIX_PATH"
PACKAGE_PATH = "PNEU_PACKAGE_PATH"

_SKIPPED = {"build", "install", "log", "test", "node_modules"}
_DEEPEST = 4


class PackageNotFoundError(KeyError):
    """Signals that a package is not installed."""

    def __str__(self) -> str:
        return f"package '{self.args[0]}' not found, searching: {search_paths()}"


def search_paths() -> list[str]:
    """Return the existing prefixes of AMENT_PREFIX_PATH; empty where it is not set."""
    prefixes = os.environ.get(PREFIX_PATH, "").split(os.pathsep)
    return [prefix for prefix in prefixes if prefix and os.path.isdir(prefix)]


def packages_with_prefixes() -> dict[str, str]:
    """Return the prefix of every package by name; of a package in a source tree its folder."""
    found: dict[str, str] = {}
    for prefix in search_paths():
        index = Path(prefix, "share", "ament_index", "resource_index", "packages")
        if index.is_dir():
            for entry in sorted(index.iterdir()):
                found.setdefault(entry.name, prefix)
    for root in [*os.environ.get(PACKAGE_PATH, "").split(os.pathsep), str(own_tree() or "")]:
        if root:
            for name, folder in _packages_below(root).items():
                found.setdefault(name, folder)
    return found


def package_prefix(name: str) -> str:
    """Return the prefix of a package; the folder of its sources where it is not installed.

    Args:
        name: Name of the package.

    Raises:
        PackageNotFoundError: It is not installed.
        ValueError: It is not a valid package name.
    """
    if not name or not name.replace("_", "a").replace("-", "a").isalnum():
        raise ValueError(f"'{name}' is no package name")
    try:
        return packages_with_prefixes()[name]
    except KeyError:
        raise PackageNotFoundError(name) from None


def package_share(name: str) -> str:
    """Return the share folder of a package, which holds its `launch/` and `config/`.

    Args:
        name: Name of the package.

    Raises:
        PackageNotFoundError: It is not installed.
        ValueError: It is not a valid package name.
    """
    prefix = package_prefix(name)
    if os.path.isfile(os.path.join(prefix, "package.xml")):
        return prefix
    return os.path.join(prefix, "share", name)


@functools.cache
def _packages_below(root: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for folder, children, files in os.walk(root, followlinks=False):
        depth = len(Path(folder).relative_to(root).parts)
        if "package.xml" in files:
            name = _package_name(Path(folder, "package.xml"))
            if name:
                found.setdefault(name, folder)
            children.clear()
            continue
        children[:] = sorted(
            child
            for child in children
            if child not in _SKIPPED and not child.startswith(".") and depth < _DEEPEST
        )
    return found


def _package_name(manifest: Path) -> str:
    try:
        return (ElementTree.parse(manifest).getroot().findtext("name") or "").strip()
    except (ElementTree.ParseError, OSError):  # not a package that anyone could build
        return ""
