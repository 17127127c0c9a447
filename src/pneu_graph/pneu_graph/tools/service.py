# SPDX-License-Identifier: Apache-2.0
"""`pneu service`: which services there are, and calling one."""

import time
from typing import Annotated

import typer

from pneu_common.errors import InputError
from pneu_common.options import finite
from pneu_graph.nodes.type_support import interface_class
from pneu_graph.tools.message_text import fill, parse_values
from pneu_graph.tools.session import absolute, hidden, spin_while, tool_node

app = typer.Typer(help="Show services, and call one.", no_args_is_help=True)


@app.command("list")
def list_services(
    show_types: Annotated[bool, typer.Option("--show-types", "-t", help="Types too.")] = False,
    count: Annotated[bool, typer.Option("--count-services", "-c", help="Only how many.")] = False,
    with_hidden: Annotated[
        bool, typer.Option("--include-hidden-services", help="Hidden services too.")
    ] = False,
) -> None:
    """Lists the services."""
    with tool_node() as node:
        services = sorted(node.get_service_names_and_types())
    services = [(name, types) for name, types in services if with_hidden or not hidden(name)]
    if count:
        print(len(services))
        return
    for name, types in services:
        print(f"{name} [{', '.join(types)}]" if show_types else name)


@app.command("type")
def type_command(name: Annotated[str, typer.Argument(help="The service.")]) -> None:
    """Prints the type of a service."""
    wanted = absolute(name)
    with tool_node(lambda node: wanted in dict(node.get_service_names_and_types())) as node:
        types = dict(node.get_service_names_and_types()).get(wanted)
    if types is None:
        raise typer.Exit(1)
    print("\n".join(types))


@app.command("call")
def call_service(
    name: Annotated[str, typer.Argument(help="The service.")],
    service_type: Annotated[str, typer.Argument(help="Its type.")],
    values: Annotated[str, typer.Argument(help='Request in YAML, such as "{data: true}".')] = "{}",
    rate_hz: Annotated[
        float, typer.Option("--rate", "-r", min=0.0, callback=finite, help="Repeat; 0: once.")
    ] = 0.0,
    timeout_s: Annotated[
        float,
        typer.Option(
            "--timeout",
            min=0.0,
            callback=finite,
            help="Longest wait for the service and the answer, s.",
        ),
    ] = 10.0,
) -> None:
    """Calls a service."""
    cls = interface_class(service_type, "srv")
    request = cls.Request()
    given = parse_values(values)
    with tool_node(look_around=False) as node:
        fill(request, given, now=node.get_clock().now().to_msg())
        client = node.create_client(cls, absolute(name))
        if not spin_while(node, lambda: not client.service_is_ready(), 0.2):
            print("waiting for service to become available...", flush=True)
            if not spin_while(node, lambda: not client.service_is_ready(), timeout_s):
                raise InputError(f"service {absolute(name)} is not there")
        while True:
            print(f"requester: making request: {request!r}\n", flush=True)
            future = client.call_async(request)
            begin = time.monotonic()
            if not spin_while(node, lambda: not future.done(), timeout_s):  # noqa: B023
                raise InputError(f"service {absolute(name)} has not answered for {timeout_s:g} s")
            print(f"response:\n{future.result()!r}\n", flush=True)
            if rate_hz <= 0.0:
                return
            rest = 1.0 / rate_hz - (time.monotonic() - begin)
            spin_while(node, lambda: True, max(0.0, rest))
