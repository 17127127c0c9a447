# SPDX-License-Identifier: Apache-2.0
"""`pneu action`: which actions there are, and sending a goal."""

import textwrap
from typing import Annotated, Any

import typer

from pneu_common.errors import InputError
from pneu_graph.nodes.type_support import interface_class
from pneu_graph.tools.message_text import fill, parse_values, plain, yaml_text
from pneu_graph.tools.node import nodes_of
from pneu_graph.tools.session import absolute, spin_while, tool_node

app = typer.Typer(help="Show actions, and send goals.", no_args_is_help=True)

STATUS = ("UNKNOWN", "ACCEPTED", "EXECUTING", "CANCELING", "SUCCEEDED", "CANCELED", "ABORTED")
"""By `action_msgs/GoalStatus`."""

SUCCEEDED = STATUS.index("SUCCEEDED")
WAIT_S = 10.0
CANCEL_S = 5.0


@app.command("list")
def list_actions(
    show_types: Annotated[bool, typer.Option("--show-types", "-t", help="Types too.")] = False,
    count: Annotated[bool, typer.Option("--count-actions", "-c", help="Only how many.")] = False,
) -> None:
    """Lists the actions."""
    with tool_node() as node:
        actions = _actions(node)
    if count:
        print(len(actions))
        return
    for name, types in actions:
        print(f"{name} [{', '.join(types)}]" if show_types else name)


def _actions(node: Any) -> list[tuple[str, list[str]]]:
    from rclpy.action import get_action_names_and_types

    return sorted(get_action_names_and_types(node))


@app.command("type")
def type_command(name: Annotated[str, typer.Argument(help="The action.")]) -> None:
    """Prints the type of an action."""
    wanted = absolute(name)
    with tool_node(lambda node: wanted in dict(_actions(node))) as node:
        types = dict(_actions(node)).get(wanted)
    if types is None:
        raise typer.Exit(1)
    print("\n".join(types))


@app.command("info")
def info(
    name: Annotated[str, typer.Argument(help="The action.")],
    show_types: Annotated[bool, typer.Option("--show-types", "-t", help="Types too.")] = False,
) -> None:
    """Shows clients and servers of an action."""
    wanted = absolute(name)
    clients: list[str] = []
    servers: list[str] = []
    with tool_node() as node:
        from rclpy.action import (
            get_action_client_names_and_types_by_node,
            get_action_server_names_and_types_by_node,
        )

        for full in nodes_of(node, with_hidden=True):
            space, _, short = full.rpartition("/")
            for found, ask in (
                (clients, get_action_client_names_and_types_by_node),
                (servers, get_action_server_names_and_types_by_node),
            ):
                types = dict(ask(node, short, space or "/")).get(wanted)
                if types is not None:
                    found.append(f"    {full}" + (f" [{', '.join(types)}]" if show_types else ""))
    print(f"Action: {name}")
    print("\n".join([f"Action clients: {len(clients)}", *clients]))
    print("\n".join([f"Action servers: {len(servers)}", *servers]))


@app.command("send_goal")
def send_goal(
    name: Annotated[str, typer.Argument(help="The action.")],
    action_type: Annotated[str, typer.Argument(help="Its type.")],
    values: Annotated[str, typer.Argument(help='Goal in YAML, such as "{order: 5}".')] = "{}",
    show_feedback: Annotated[bool, typer.Option("--feedback", "-f", help="Show feedback.")] = False,
) -> None:
    """Sends a goal and waits for its result; Ctrl-C cancels it."""
    cls = interface_class(action_type, "action")
    goal = cls.Goal()
    given = parse_values(values)

    def feedback(message: Any) -> None:
        _show("Feedback:", message.feedback)

    with tool_node(look_around=False) as node:
        from rclpy.action import ActionClient

        from pneu_graph.nodes.discovery import patience_s

        fill(goal, given, now=node.get_clock().now().to_msg())
        client = ActionClient(node, cls, absolute(name))
        print("Waiting for an action server to become available...", flush=True)
        if not spin_while(node, lambda: not client.server_is_ready(), patience_s(WAIT_S)):
            raise InputError(f"action {absolute(name)} has no server")
        _show("Sending goal:", goal)
        sent = client.send_goal_async(goal, feedback if show_feedback else None)
        if not spin_while(node, lambda: not sent.done(), WAIT_S):
            raise InputError(f"action {absolute(name)} has not answered for {WAIT_S:g} s")
        handle = sent.result()
        if not handle.accepted:
            typer.echo("Goal was rejected.", err=True)
            raise typer.Exit(1)
        print(f"Goal accepted with ID: {bytes(handle.goal_id.uuid).hex()}\n", flush=True)
        answer = handle.get_result_async()
        try:
            spin_while(node, lambda: not answer.done())
        except KeyboardInterrupt:
            print("Canceling goal...", flush=True)
            canceled = handle.cancel_goal_async()
            spin_while(node, lambda: not canceled.done(), CANCEL_S)
            raise
        if not answer.done():  # the context was shut down
            raise typer.Exit(1)
        _show("Result:", answer.result().result)
        print(f"Goal finished with status: {STATUS[answer.result().status]}", flush=True)
        client.destroy()
        if answer.result().status != SUCCEEDED:
            raise typer.Exit(1)


def _show(title: str, message: Any) -> None:
    print(f"{title}\n{textwrap.indent(yaml_text(plain(message)), '    ')}", flush=True)
