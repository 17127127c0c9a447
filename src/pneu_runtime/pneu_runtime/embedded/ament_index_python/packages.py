# SPDX-License-Identifier: Apache-2.0
"""Where a package is installed, by the names and arguments of the genuine module."""

from pathlib import Path

from pneu_runtime.packages import PackageNotFoundError, package_share
from pneu_runtime.packages import package_prefix as get_package_prefix
from pneu_runtime.packages import packages_with_prefixes as get_packages_with_prefixes

__all__ = [
    "PackageNotFoundError",
    "get_package_prefix",
    "get_package_share_directory",
    "get_package_share_path",
    "get_packages_with_prefixes",
]


def get_package_share_directory(package_name: str, print_warning: bool = True) -> str:
    """Return the share folder of a package, which holds its `launch/` and `config/`.

    Args:
        package_name: Name of the package.
        print_warning: Kept for compatibility.

    Raises:
        PackageNotFoundError: It is not installed.
        ValueError: It is not a valid package name.
    """
    return package_share(package_name)


def get_package_share_path(package_name: str, print_warning: bool = True) -> Path:
    """Return the share folder of a package as a path.

    Args:
        package_name: Name of the package.
        print_warning: Kept for compatibility.

    Raises:
        PackageNotFoundError: It is not installed.
        ValueError: It is not a valid package name.
    """
    return Path(package_share(package_name))
