# SPDX-License-Identifier: Apache-2.0
"""Packages of messages, services and actions, distinguished from others without importing them."""

import importlib.machinery
import sys
from pathlib import Path


def has_interfaces(package: str, kind: str) -> bool:
    """Return whether an installed package looks like one of messages, without importing it.

    A type's name comes from recordings, the graph and rig files, and an import runs code.

    Args:
        package: Such as ``sensor_msgs``.
        kind: ``msg``, ``srv`` or ``action``.
    """
    if package in sys.modules and f"{package}.{kind}" in sys.modules:
        return True
    for finder in sys.meta_path:
        spec = finder.find_spec(package, None, None)
        if spec is None:
            continue
        if getattr(spec.loader, "holds_interfaces", False):  # made from definitions, without files
            return True
        places = spec.submodule_search_locations or []
        endings = importlib.machinery.all_suffixes()
        return any(
            (Path(place) / kind / f"__init__{ending}").is_file()
            for place in places
            for ending in endings
        )
    return False
