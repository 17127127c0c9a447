# SPDX-License-Identifier: Apache-2.0
"""`pneu lifecycle`: states of nodes with hardware, and changing them."""

from collections.abc import Callable
from typing import Annotated, Any

import typer

from pneu_common.errors import InputError
from pneu_graph.tools.session import absolute, call, hidden, tool_node

app = typer.Typer(help="Show and change states of lifecycle nodes.", no_args_is_help=True)

Name = Annotated[str, typer.Argument(help="The node.")]

GET_STATE = "lifecycle_msgs/srv/GetState"


def _lifecycle_nodes(node: Any) -> list[str]:
    return sorted(
        name.removesuffix("/get_state")
        for name, types in node.get_service_names_and_types()
        if name.endswith("/get_state") and GET_STATE in types and not hidden(name)
    )


def _named(name: str) -> Callable[[Any], bool]:
    return lambda node: absolute(name) in _lifecycle_nodes(node)


def _known(node: Any, name: str) -> str:
    if not _named(name)(node):
        typer.echo("Node not found", err=True)
        raise typer.Exit(1)
    return absolute(name)


def _ask(node: Any, target: str, service: str, kind: str, **fields: Any) -> Any:
    import lifecycle_msgs.srv as srv

    cls = getattr(srv, kind)
    return call(node, cls, f"{target}/{service}", cls.Request(**fields), f"node {target}")


@app.command("nodes")
def nodes() -> None:
    """Lists the lifecycle nodes."""
    with tool_node() as node:
        names = _lifecycle_nodes(node)
    for name in names:
        print(name)


@app.command("get")
def get(name: Annotated[str, typer.Argument(help="Only this node.")] = "") -> None:
    """Prints the state of a node, or of all."""
    with tool_node(_named(name) if name else None) as node:
        targets = [_known(node, name)] if name else _lifecycle_nodes(node)
        for target in targets:
            state = _ask(node, target, "get_state", "GetState").current_state
            print(f"{'' if name else target + ': '}{state.label} [{state.id}]", flush=True)


@app.command("set")
def set_state(
    name: Name,
    transition: Annotated[str, typer.Argument(help="Such as configure, activate, or its number.")],
) -> None:
    """Changes the state of a node."""
    with tool_node(_named(name)) as node:
        target = _known(node, name)
        possible = _ask(
            node, target, "get_available_transitions", "GetAvailableTransitions"
        ).available_transitions
        for entry in possible:
            if transition in (entry.transition.label, str(entry.transition.id)):
                done = _ask(
                    node, target, "change_state", "ChangeState", transition=entry.transition
                )
                break
        else:
            words = [f"{entry.transition.label} [{entry.transition.id}]" for entry in possible]
            raise InputError(
                f"node {target}: transition {transition!r} is not possible now; possible are"
                f" {', '.join(words) or 'none'}"
            )
    if not done.success:
        typer.echo("Transitioning failed", err=True)
        raise typer.Exit(1)
    print("Transitioning successful")


@app.command("list")
def list_transitions(
    name: Name,
    everything: Annotated[
        bool, typer.Option("--all", "-a", help="Also those that are not possible now.")
    ] = False,
) -> None:
    """Lists the transitions of a node."""
    service = "get_transition_graph" if everything else "get_available_transitions"
    with tool_node(_named(name)) as node:
        target = _known(node, name)
        found = _ask(node, target, service, "GetAvailableTransitions").available_transitions
    for entry in found:
        print(f"- {entry.transition.label} [{entry.transition.id}]")
        print(f"\tStart: {entry.start_state.label}")
        print(f"\tGoal: {entry.goal_state.label}")
