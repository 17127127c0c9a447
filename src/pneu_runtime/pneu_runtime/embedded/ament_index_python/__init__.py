# SPDX-License-Identifier: Apache-2.0
"""Where packages are installed: the part of `ament_index_python` that nodes and launch files use.

See `pneu_runtime.packages`. Unlike in a ROS installation AMENT_PREFIX_PATH may be absent.
"""

from ament_index_python.packages import (
    PackageNotFoundError,
    get_package_prefix,
    get_package_share_directory,
    get_package_share_path,
    get_packages_with_prefixes,
)
from ament_index_python.search_paths import get_search_paths

__all__ = [
    "PackageNotFoundError",
    "get_package_prefix",
    "get_package_share_directory",
    "get_package_share_path",
    "get_packages_with_prefixes",
    "get_search_paths",
]
