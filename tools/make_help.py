# SPDX-License-Identifier: Apache-2.0
"""Print the targets of a Makefile that carry a `## description`."""

import re
import sys
from pathlib import Path

if __name__ == "__main__":
    for line in Path(sys.argv[1]).read_text(encoding="utf-8").splitlines():
        found = re.match(r"([a-z-]+):.*?##\s+(.*)", line)
        if found:
            print("make {:<14} {}".format(*found.groups()))
