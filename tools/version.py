# SPDX-License-Identifier: Apache-2.0
"""Set the version of the project: `python tools/version.py 1.2.3`.

It stands in `pyproject.toml` and, because ROS reads each package on its own, in every
`package.xml`; a test keeps them equal.
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PLACES = {
    "pyproject.toml": r'^version = "([^"]+)"$',
    "msgs/package.xml": r"<version>([^<]+)</version>",
    "src/*/package.xml": r"<version>([^<]+)</version>",
    "ros_ws/src/pneu_bringup/package.xml": r"<version>([^<]+)</version>",
}
"""Patterns of files, and the expression whose group is the version."""


def versions():
    """Return the version that each file holds, by path."""
    found = {}
    for path, expression in _files():
        found[path] = re.search(expression, path.read_text(encoding="utf-8"), re.M)[1]
    return found


def set_version(version):
    """Write a version into each file.

    Args:
        version: Three numbers, as catkin and PEP 440 both allow.
    """
    for path, expression in _files():
        text = path.read_text(encoding="utf-8")
        found = re.search(expression, text, re.M)
        path.write_text(text[: found.start(1)] + version + text[found.end(1) :], encoding="utf-8")


def _files():
    for pattern, expression in PLACES.items():
        for path in sorted(ROOT.glob(pattern)):
            yield path, expression


if __name__ == "__main__":
    if len(sys.argv) != 2 or not re.fullmatch(r"\d+\.\d+\.\d+", sys.argv[1]):
        sys.exit("usage: python tools/version.py MAJOR.MINOR.PATCH")
    set_version(sys.argv[1])
