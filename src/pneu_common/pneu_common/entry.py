# SPDX-License-Identifier: Apache-2.0
"""Where the `pneu` command begins: what somebody waits for in danger goes first.

Such subcommands come from the entry-point group `pneu.at_once`; all others from `pneu_common.cli`.
"""

import sys

from pneu_common import children, process

AT_ONCE_GROUP = "pneu.at_once"
COMMAND = tuple(children.python("pneu_common.entry"))
"""The `pneu` command for a process of its own, whether or not it is on the path."""


def main() -> None:
    """Run the `pneu` command line on `sys.argv` and exit with its status."""
    process.prepare()
    children.keep_to_installed()
    import importlib.metadata  # slow, therefore after the handlers of signals

    if len(sys.argv) > 1:
        for found in importlib.metadata.entry_points(group=AT_ONCE_GROUP, name=sys.argv[1]):
            at_once = found.load()
            process.begin_work()
            try:
                status = at_once(sys.argv[2:])
                process.raise_postponed()
            except KeyboardInterrupt as interrupt:
                message, status = process.ending(interrupt)
                print("pneu:", message, file=sys.stderr)
            if status is not None:
                process.restore_signals()
                sys.exit(status)
    from pneu_common.cli import main as command_line

    command_line()


if __name__ == "__main__":
    main()
