# SPDX-License-Identifier: Apache-2.0
"""The places that are searched for packages."""

import functools
import importlib.metadata
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

AMENT_PREFIX_PATH_ENV_VAR = "AMENT_PREFIX_PATH"
PACKAGE_PATH_ENV_VAR = "PNEU_PACKAGE_PATH"

_SKIPPED = {"build", "install", "log", "test", "node_modules"}
_DEEPEST = 4


def get_search_paths() -> list[str]:
    """Returns the existing prefixes of AMENT_PREFIX_PATH.

    Unlike in a ROS installation the variable may be absent.
    """
    prefixes = os.environ.get(AMENT_PREFIX_PATH_ENV_VAR, "").split(os.pathsep)
    return [prefix for prefix in prefixes if prefix and os.path.isdir(prefix)]


def source_packages() -> dict[str, str]:
    """Returns the folders of packages in source trees by package name."""
    found: dict[str, str] = {}
    named = os.environ.get(PACKAGE_PATH_ENV_VAR, "").split(os.pathsep)
    for root in [*named, _own_tree()]:
        if root:
            for name, folder in _packages_below(root).items():
                found.setdefault(name, folder)
    return found


def _own_tree() -> str:
    """The source tree that this file lies in; empty in an installation without sources."""
    # <tree>/src/pneu_runtime/pneu_runtime/embedded/ament_index_python/search_paths.py
    parents = Path(__file__).resolve().parents
    if len(parents) > 5 and parents[4].name == "src" and (parents[3] / "package.xml").exists():
        return str(parents[5])
    return ""


@functools.cache
def wheel_packages() -> dict[str, str]:
    """Returns the prefixes of the packages that came with a wheel, by package name."""
    try:
        files = importlib.metadata.files("pneu") or []
    except importlib.metadata.PackageNotFoundError:
        return {}
    found: dict[str, str] = {}
    for file in files:
        if file.parts[-3:-2] == ("share",) and file.name == "package.xml":
            folder = Path(str(file.locate())).resolve().parent
            if (folder / "package.xml").is_file():
                found[folder.name] = str(folder.parents[1])
    return found


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
