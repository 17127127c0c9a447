# SPDX-License-Identifier: Apache-2.0
"""`pneu node`: which nodes there are, and what each has."""

from collections import Counter
from collections.abc import Callable
from typing import Annotated, Any

import typer

from pneu_graph.tools.session import absolute, full_name, hidden, tool_node

app = typer.Typer(help="Show the nodes of the graph.", no_args_is_help=True)


def nodes_of(node: Any, with_hidden: bool = False) -> list[str]:
    """Returns the names of all nodes, sorted.

    Args:
        node: Node that looks.
        with_hidden: Also those whose name begins with an underscore.
    """
    found = [full_name(space, name) for name, space in node.get_node_names_and_namespaces()]
    return sorted(name for name in found if with_hidden or not hidden(name))


def named(name: str) -> Callable[[Any], bool]:
    """Returns whether a node that looks sees the node of a name.

    Args:
        name: With or without the leading slash.
    """
    return lambda node: absolute(name) in nodes_of(node, with_hidden=True)


@app.command("list")
def list_nodes(
    with_hidden: Annotated[bool, typer.Option("--all", "-a", help="Hidden nodes too.")] = False,
    count: Annotated[
        bool, typer.Option("--count-nodes", "-c", help="Only how many there are.")
    ] = False,
) -> None:
    """Lists the nodes."""
    with tool_node() as node:
        names = nodes_of(node, with_hidden)
    if count:
        print(len(names))
        return
    print("\n".join(names), end="\n" if names else "")
    for name, times in Counter(names).items():
        if times > 1:
            typer.echo(f"WARNING: {times} nodes share the name {name}", err=True)


@app.command("info")
def info(
    name: Annotated[str, typer.Argument(help="The node.")],
    with_hidden: Annotated[
        bool, typer.Option("--include-hidden", help="Hidden topics and services too.")
    ] = False,
) -> None:
    """Shows topics, services and actions of a node."""
    wanted = absolute(name)
    with tool_node() as node:
        if wanted not in nodes_of(node, with_hidden=True):
            typer.echo(f"Unable to find node '{name}'", err=True)
            raise typer.Exit(1)
        space, _, short = wanted.rpartition("/")
        sections = _sections(node, short, space or "/")
    print(wanted)
    for title, entries in sections:
        print(f"  {title}:")
        for entry, types in sorted(entries):
            if with_hidden or not hidden(entry):
                print(f"    {entry}: {', '.join(types)}")
        if not entries and title != "Subscribers" and title != "Publishers":
            print()


def _sections(node: Any, name: str, namespace: str) -> list[tuple[str, Any]]:
    from rclpy.action import (
        get_action_client_names_and_types_by_node,
        get_action_server_names_and_types_by_node,
    )

    return [
        ("Subscribers", node.get_subscriber_names_and_types_by_node(name, namespace)),
        ("Publishers", node.get_publisher_names_and_types_by_node(name, namespace)),
        ("Service Servers", node.get_service_names_and_types_by_node(name, namespace)),
        ("Service Clients", node.get_client_names_and_types_by_node(name, namespace)),
        ("Action Servers", get_action_server_names_and_types_by_node(node, name, namespace)),
        ("Action Clients", get_action_client_names_and_types_by_node(node, name, namespace)),
    ]
