# SPDX-License-Identifier: Apache-2.0
"""Subcommands of `pneu` that work on a recording: which there are."""

import typer

from pneu_sysid.command.add import add
from pneu_sysid.command.compare import compare
from pneu_sysid.command.diagnose import diagnose
from pneu_sysid.command.fit import fit
from pneu_sysid.command.friction import friction
from pneu_sysid.command.learn import learn
from pneu_sysid.contacts.table_commands import contacts
from pneu_sysid.design.command import excite
from pneu_sysid.observed.command import observe


def register(app: typer.Typer) -> None:
    """Adds these subcommands to the `pneu` application.

    Args:
        app: The application.
    """
    app.command("fit")(fit)
    app.command("compare")(compare)
    app.command("diagnose")(diagnose)
    app.command("add")(add)
    app.command("learn")(learn)
    app.command("friction")(friction)
    app.command("contacts")(contacts)
    app.command("excite")(excite)
    app.command("observe")(observe)
