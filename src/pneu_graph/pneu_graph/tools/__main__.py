# SPDX-License-Identifier: Apache-2.0
"""The commands on the graph alone: `python -m pneu_graph.tools topic list`.

They start at once, where `pneu` first loads the simulator and the identification.
"""

from importlib.metadata import EntryPoint

from pneu_common import process
from pneu_common.cli import COMMANDS_GROUP, build_app

if __name__ == "__main__":
    process.prepare()
    here = EntryPoint("runtime", "pneu_graph.commands:register", COMMANDS_GROUP)
    build_app([here])(prog_name="pneu")
