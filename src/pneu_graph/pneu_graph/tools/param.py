# SPDX-License-Identifier: Apache-2.0
"""`pneu param`: parameters of running nodes."""

from pathlib import Path
from typing import Annotated, Any

import typer

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_graph.tools.message_text import yaml_text
from pneu_graph.tools.node import named, nodes_of
from pneu_graph.tools.parameter_value import (
    TYPE_NAMES,
    from_text,
    message_value,
    python_value,
)
from pneu_graph.tools.session import absolute, call, tool_node

app = typer.Typer(help="Show and set parameters of nodes.", no_args_is_help=True)

Node = Annotated[str, typer.Argument(help="The node.")]
Parameter = Annotated[str, typer.Argument(help="The parameter.")]


def _ask(node: Any, service: str, target: str, **fields: Any) -> Any:
    import rcl_interfaces.srv as srv

    words = {
        "list_parameters": srv.ListParameters,
        "get_parameters": srv.GetParameters,
        "describe_parameters": srv.DescribeParameters,
        "set_parameters": srv.SetParameters,
    }
    kind = words[service]
    return call(node, kind, f"{target}/{service}", kind.Request(**fields), f"node {target}")


def _existing(node: Any, name: str) -> str:
    if not named(name)(node):
        typer.echo("Node not found", err=True)
        raise typer.Exit(1)
    return absolute(name)


def _names(node: Any, target: str) -> list[str]:
    return sorted(_ask(node, "list_parameters", target).result.names)


@app.command("list")
def list_parameters(
    name: Annotated[str, typer.Argument(help="Only this node.")] = "",
    show_types: Annotated[
        bool, typer.Option("--param-type", help="Types of the parameters too.")
    ] = False,
) -> None:
    """Lists the parameters of every node."""
    with tool_node(named(name) if name else None) as node:
        targets = [_existing(node, name)] if name else nodes_of(node)
        for target in targets:
            try:
                names = _names(node, target)
                values = _ask(node, "get_parameters", target, names=names).values
            except InputError as error:
                if name:
                    raise
                typer.echo(str(error), err=True)  # one node that hangs hides no other
                continue
            if not name:
                print(f"{target}:")
            for parameter, value in zip(names, values, strict=False):
                kind = f" (type: {TYPE_NAMES[value.type]})" if show_types else ""
                print(f"  {parameter}{kind}")


@app.command("get")
def get(
    name: Node,
    parameter: Parameter,
    hide_type: Annotated[bool, typer.Option("--hide-type", help="Only the value.")] = False,
) -> None:
    """Prints a parameter."""
    with tool_node(named(name)) as node:
        target = _existing(node, name)
        values = _ask(node, "get_parameters", target, names=[parameter]).values
    if not values or values[0].type == 0:
        typer.echo("Parameter not set.", err=True)
        raise typer.Exit(1)
    kind = TYPE_NAMES[values[0].type]
    shown = python_value(values[0])
    scalar, array, _ = kind.partition(" array")
    label = f"{scalar.capitalize()} values are: " if array else f"{kind.capitalize()} value is: "
    print(shown if hide_type else f"{label}{shown}")


@app.command("set", context_settings={"ignore_unknown_options": True})
def set_parameter(
    name: Node,
    parameter: Parameter,
    value: Annotated[str, typer.Argument(help="The value, as YAML.")],
) -> None:
    """Sets a parameter."""
    with tool_node(named(name)) as node:
        target = _existing(node, name)
        if not _set(node, target, {parameter: from_text(value)}, brief=True):
            raise typer.Exit(1)


def _set(node: Any, target: str, values: dict[str, Any], brief: bool) -> bool:
    from rcl_interfaces.msg import Parameter as ParameterMessage

    wanted = []
    for name, value in values.items():
        try:
            wanted.append(ParameterMessage(name=name, value=message_value(value)))
        except ValueError as error:
            raise InputError(f"parameter {name} of {target}: {error}") from None
    results = _ask(node, "set_parameters", target, parameters=wanted).results
    for name, result in zip(values, results, strict=False):
        if result.successful:
            print("Set parameter successful" if brief else f"Set parameter {name} successful")
        else:
            about = f": {result.reason}" if result.reason else ""
            what = "Setting parameter failed" if brief else f"Set parameter {name} failed"
            typer.echo(f"{what}{about}", err=True)
    return all(result.successful for result in results)


@app.command("dump")
def dump(name: Node) -> None:
    """Prints all parameters of a node in the form of a parameter file."""
    with tool_node(named(name)) as node:
        target = _existing(node, name)
        names = _names(node, target)
        values = _ask(node, "get_parameters", target, names=names).values
    tree: dict[str, Any] = {}
    for parameter, value in zip(names, values, strict=False):
        *groups, leaf = parameter.split(".")
        inner = tree
        for group in groups:
            inner = inner.setdefault(group, {})
        inner[leaf] = python_value(value)
    print(yaml_text({target: {"ros__parameters": tree}}), end="")


@app.command("load")
def load(name: Node, path: Annotated[Path, typer.Argument(help="The parameter file.")]) -> None:
    """Sets parameters of a node from a parameter file."""
    with tool_node(named(name)) as node:
        target = _existing(node, name)
        values = _from_file(path, target)
        if not _set(node, target, values, brief=False):
            raise typer.Exit(1)


def _from_file(path: Path, target: str) -> dict[str, Any]:
    data = read_yaml(path, "parameter file")
    values: dict[str, Any] = {}
    for key in ("/**", target, target.lstrip("/")):
        section = data.get(key) if isinstance(data, dict) else None
        if isinstance(section, dict):
            values.update(_flat(section.get("ros__parameters") or {}))
    if not values:
        raise InputError(f"{path}: has no parameters of {target}, and none of '/**'")
    return values


def _flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    values: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            values.update(_flat(value, f"{prefix}{key}."))
        else:
            values[f"{prefix}{key}"] = value
    return values


@app.command("describe")
def describe(
    name: Node, parameters: Annotated[list[str], typer.Argument(help="The parameters.")]
) -> None:
    """Describes parameters: type, range, whether they can be changed."""
    with tool_node(named(name)) as node:
        target = _existing(node, name)
        found = _ask(node, "describe_parameters", target, names=list(parameters)).descriptors
    for descriptor in found:
        print(f"Parameter name: {descriptor.name}")
        print(f"  Type: {TYPE_NAMES[descriptor.type]}")
        if descriptor.description:
            print(f"  Description: {descriptor.description}")
        print("  Constraints:")
        if descriptor.read_only:
            print("    Read only: true")
        for limits in [*descriptor.floating_point_range, *descriptor.integer_range]:
            print(f"    Min value: {limits.from_value}")
            print(f"    Max value: {limits.to_value}")
            if limits.step:
                print(f"    Step: {limits.step}")
        if descriptor.additional_constraints:
            print(f"    Additional constraints: {descriptor.additional_constraints}")


@app.command("delete")
def delete(name: Node, parameter: Parameter) -> None:
    """Removes a parameter from a node."""
    with tool_node(named(name)) as node:
        target = _existing(node, name)
        if not _set(node, target, {parameter: None}, brief=True):
            raise typer.Exit(1)
