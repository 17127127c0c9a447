# SPDX-License-Identifier: Apache-2.0
"""`pneu interface`: which message, service and action types there are, and what is in one."""

from typing import Annotated

import typer

from pneu_common.errors import InputError
from pneu_graph.nodes.type_support import KINDS

app = typer.Typer(help="Show message, service and action types.", no_args_is_help=True)

TITLES = {"msg": "Messages", "srv": "Services", "action": "Actions"}


@app.command("list")
def list_interfaces(
    only_msgs: Annotated[bool, typer.Option("--only-msgs", "-m", help="Only messages.")] = False,
    only_srvs: Annotated[bool, typer.Option("--only-srvs", "-s", help="Only services.")] = False,
    only_actions: Annotated[
        bool, typer.Option("--only-actions", "-a", help="Only actions.")
    ] = False,
) -> None:
    """Lists the types."""
    from pneu_runtime import interfaces

    wanted = {"msg": only_msgs, "srv": only_srvs, "action": only_actions}
    known = interfaces.known_types()
    for kind, title in TITLES.items():
        if wanted[kind] or not any(wanted.values()):
            print(f"{title}:")
            for name in sorted(name for name in known if f"/{kind}/" in name):
                print(f"    {name}")


@app.command("show")
def show(name: Annotated[str, typer.Argument(help="Such as std_msgs/msg/String.")]) -> None:
    """Prints the definition of a type, with that of the types in it."""
    from pneu_runtime import interfaces

    kind = name.split("/")[1] if name.count("/") == 2 else ""
    if kind not in KINDS:
        raise InputError(f"type {name!r}: is written package/msg/Name, or with srv or action")
    if kind == "msg":
        # The definitions that follow the first one stand where they are used, as a reader expects.
        own, *others = interfaces.full_text(name).split("=" * 80 + "\n")
        texts = {}
        for other in others:
            head, _, text = other.partition("\n")
            texts[head.removeprefix("MSG: ").strip()] = text
        print("\n".join(_expanded(own.rstrip("\n"), texts, name.split("/")[0])))
    else:
        print(interfaces.full_text(name).rstrip("\n"))


def _expanded(text: str, others: dict[str, str], package: str) -> list[str]:
    lines = []
    for line in text.splitlines():
        lines.append(line)
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        kind = words[0].partition("[")[0]
        full = kind if "/" in kind else f"{package}/{kind}"
        if full == f"{package}/Header":
            full = "std_msgs/Header"
        if full in others:
            for inner in _expanded(others[full].rstrip("\n"), others, full.split("/")[0]):
                if inner and not inner.lstrip().startswith("#"):
                    lines.append(f"\t{inner}")
    return lines
