# SPDX-License-Identifier: Apache-2.0
"""The prefixes that are searched for packages."""

from pneu_runtime.packages import PREFIX_PATH as AMENT_PREFIX_PATH_ENV_VAR
from pneu_runtime.packages import search_paths as get_search_paths

__all__ = ["AMENT_PREFIX_PATH_ENV_VAR", "get_search_paths"]
