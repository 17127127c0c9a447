# SPDX-License-Identifier: Apache-2.0
"""Where a package is installed."""

import os
from pathlib import Path

from ament_index_python.search_paths import get_search_paths, source_packages, wheel_packages


class PackageNotFoundError(KeyError):
    """Signals that a package is not installed."""

    def __str__(self) -> str:
        return f"package '{self.args[0]}' not found, searching: {get_search_paths()}"


def get_packages_with_prefixes() -> dict[str, str]:
    """Returns the prefixes of all packages by name."""
    found: dict[str, str] = {}
    for prefix in get_search_paths():
        index = Path(prefix, "share", "ament_index", "resource_index", "packages")
        if index.is_dir():
            for entry in sorted(index.iterdir()):
                found.setdefault(entry.name, prefix)
    for name, folder in (*source_packages().items(), *wheel_packages().items()):
        found.setdefault(name, folder)
    return found


def get_package_prefix(package_name: str) -> str:
    """Returns the prefix of a package; the folder of its sources where it is not installed.

    Args:
        package_name: Its name.

    Raises:
        PackageNotFoundError: It is not installed.
        ValueError: It is no name of a package.
    """
    if not package_name or not package_name.replace("_", "a").replace("-", "a").isalnum():
        raise ValueError(f"'{package_name}' is no package name")
    try:
        return get_packages_with_prefixes()[package_name]
    except KeyError:
        raise PackageNotFoundError(package_name) from None


def get_package_share_directory(package_name: str, print_warning: bool = True) -> str:
    """Returns the share folder of a package: where its `launch/` and `config/` are.

    Args:
        package_name: Its name.
        print_warning: Kept for compatibility.

    Raises:
        PackageNotFoundError: It is not installed.
        ValueError: It is no name of a package.
    """
    prefix = get_package_prefix(package_name)
    if os.path.isfile(os.path.join(prefix, "package.xml")):
        return prefix
    return os.path.join(prefix, "share", package_name)


def get_package_share_path(package_name: str, print_warning: bool = True) -> Path:
    """Returns the share folder of a package as a path.

    Args:
        package_name: Its name.
        print_warning: Kept for compatibility.

    Raises:
        PackageNotFoundError: It is not installed.
        ValueError: It is no name of a package.
    """
    return Path(get_package_share_directory(package_name, print_warning))
