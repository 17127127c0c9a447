# SPDX-License-Identifier: Apache-2.0
"""Where the `pneu` command begins: what somebody waits for in danger goes first.

Such subcommands come from the entry-point group `pneu.at_once`; all others from `pneu_common.cli`.
"""

import importlib.metadata
import sys

AT_ONCE_GROUP = "pneu.at_once"
COMMAND = (sys.executable, "-m", "pneu_common.entry")
"""The `pneu` command for a process of its own, whether or not it is on the path."""


def main() -> None:
    """Run the `pneu` command line on `sys.argv` and exit with its status."""
    if len(sys.argv) > 1:
        for found in importlib.metadata.entry_points(group=AT_ONCE_GROUP, name=sys.argv[1]):
            status = found.load()(sys.argv[2:])
            if status is not None:
                sys.exit(status)
    from pneu_common.cli import main as command_line

    command_line()


if __name__ == "__main__":
    main()
