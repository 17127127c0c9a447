# SPDX-License-Identifier: Apache-2.0
"""`pneu topic`: which topics there are, what is on them, and publishing by hand."""

import os
import sys
import time
from collections.abc import Callable
from typing import Annotated, Any

import typer

from pneu_common.errors import InputError
from pneu_common.options import finite
from pneu_graph.nodes.type_support import interface_class
from pneu_graph.tools import rates
from pneu_graph.tools.endpoint_text import endpoint_text
from pneu_graph.tools.message_text import (
    TRUNCATE_LENGTH,
    fill,
    parse_values,
    plain,
    yaml_text,
)
from pneu_graph.tools.qos_options import chosen_profile, matching_profile
from pneu_graph.tools.session import absolute, hidden, nobody_found, spin_while, tool_node

app = typer.Typer(help="Show topics, and publish by hand.", no_args_is_help=True)
Name = Annotated[str, typer.Argument(help="The topic.")]
Reliability = Annotated[str, typer.Option("--qos-reliability", help="reliable or best_effort.")]
Durability = Annotated[str, typer.Option("--qos-durability", help="volatile or transient_local.")]
Depth = Annotated[int, typer.Option("--qos-depth", min=0, help="Length of the queue; 0: default.")]
Window = Annotated[int, typer.Option("--window", "-w", min=1, help="Messages to average over.")]
Seconds = Annotated[
    float, typer.Option("--seconds", min=0.0, callback=finite, help="Stop after, s; 0: never.")
]


def topics_of(node: Any, with_hidden: bool = False) -> list[tuple[str, list[str]]]:
    """Returns names and types of all topics, sorted.

    Args:
        node: Node that looks.
        with_hidden: Also those with a part that begins with an underscore.
    """
    found = sorted(node.get_topic_names_and_types())
    return [(name, types) for name, types in found if with_hidden or not hidden(name)]


def type_of(node: Any, topic: str) -> str:
    """Returns the type of a topic that somebody publishes or subscribes.

    Args:
        node: Node that looks.
        topic: The topic.

    Raises:
        InputError: The topic is not there, or has several types.
    """
    types = dict(topics_of(node, with_hidden=True)).get(topic)
    if types is None:
        raise InputError(
            f"topic {topic} does not appear to be published yet, so its type is not known"
        )
    if len(types) > 1:
        raise InputError(f"topic {topic} has several types: {', '.join(types)}")
    return types[0]


def _published(topic: str) -> Callable[[Any], bool]:
    """Whether a node that looks sees a publisher, whose type and QoS a subscription takes."""
    return lambda node: bool(node.get_publishers_info_by_topic(topic))


@app.command("list")
def list_topics(
    show_types: Annotated[bool, typer.Option("--show-types", "-t", help="Types too.")] = False,
    count: Annotated[bool, typer.Option("--count-topics", "-c", help="Only how many.")] = False,
    with_hidden: Annotated[
        bool, typer.Option("--include-hidden-topics", help="Hidden topics too.")
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Publishers and subscribers too.")
    ] = False,
) -> None:
    """Lists the topics."""
    with tool_node() as node:
        topics = topics_of(node, with_hidden)
        alone = len(node.get_node_names()) <= 1
        counts = {name: (node.count_publishers(name), node.count_subscribers(name))
                  for name, _ in topics} if verbose else {}  # fmt: skip
    if alone:
        print(nobody_found(os.environ), file=sys.stderr)
    if count:
        print(len(topics))
    elif verbose:
        for which, title, unit in ((0, "Published", "publisher"), (1, "Subscribed", "subscriber")):
            print(f"{title} topics:")
            for name, types in topics:
                number = counts[name][which]
                if number:
                    plural = "s" if number > 1 else ""
                    print(f" * {name} [{', '.join(types)}] {number} {unit}{plural}")
            print()
    else:
        for name, types in topics:
            print(f"{name} [{', '.join(types)}]" if show_types else name)


@app.command("type")
def type_command(topic: Name) -> None:
    """Prints the type of a topic."""
    name = absolute(topic)
    with tool_node(lambda node: name in dict(topics_of(node, with_hidden=True))) as node:
        types = dict(topics_of(node, with_hidden=True)).get(name)
    if types is None:
        raise typer.Exit(1)
    print("\n".join(types))


@app.command("info")
def info(
    topic: Name,
    verbose: Annotated[
        bool, typer.Option("--verbose", "-v", help="Nodes, QoS and type hashes.")
    ] = False,
) -> None:
    """Shows type and endpoints of a topic."""
    name = absolute(topic)
    with tool_node() as node:
        types = dict(topics_of(node, with_hidden=True)).get(name)
        if types is None:
            typer.echo(f"Unknown topic '{topic}'", err=True)
            raise typer.Exit(1)
        publishers = node.get_publishers_info_by_topic(name)
        subscriptions = node.get_subscriptions_info_by_topic(name)
    print("Type:", types[0] if len(types) == 1 else types)
    for title, endpoints in (("Publisher", publishers), ("Subscription", subscriptions)):
        if verbose:
            print()
        print(f"{title} count: {len(endpoints)}")
        if verbose:
            for endpoint in endpoints:
                print("\n" + endpoint_text(endpoint))
    if verbose:
        print()


@app.command("echo")
def echo(
    topic: Name,
    message_type: Annotated[str, typer.Argument(help="Its type, where not yet known.")] = "",
    once: Annotated[bool, typer.Option("--once", help="Only the first message.")] = False,
    timeout_s: Annotated[
        float,
        typer.Option(
            "--timeout", min=0.0, callback=finite, help="Give up after so long, s; 0: never."
        ),
    ] = 0.0,
    field: Annotated[str, typer.Option("--field", help="Only this field, such as a.b.")] = "",
    csv: Annotated[bool, typer.Option("--csv", help="Values on one line, with commas.")] = False,
    raw: Annotated[bool, typer.Option("--raw", help="The bytes as they come.")] = False,
    flow_style: Annotated[bool, typer.Option("--flow-style", help="On one line.")] = False,
    full_length: Annotated[
        bool, typer.Option("--full-length", "-f", help="Long arrays and texts whole.")
    ] = False,
    truncate_length: Annotated[
        int, typer.Option("--truncate-length", "-l", min=0, help="Longest array and text.")
    ] = TRUNCATE_LENGTH,
    no_arr: Annotated[bool, typer.Option("--no-arr", help="Leave arrays out.")] = False,
    no_str: Annotated[bool, typer.Option("--no-str", help="Leave texts out.")] = False,
    reliability: Reliability = "",
    durability: Durability = "",
    depth: Depth = 0,
) -> None:
    """Prints the messages of a topic."""
    name = absolute(topic)
    seen = 0
    longest = None if full_length or csv else truncate_length

    def show(message: Any) -> None:
        nonlocal seen
        if once and seen:
            return
        seen += 1
        if raw:
            print(f"{bytes(message)!r}\n---", flush=True)
            return
        for part in [part for part in field.split(".") if part]:
            if not hasattr(message, part):
                raise InputError(f"--field {field}: the message has no field {part!r}")
            message = getattr(message, part)
        shown = plain(message, longest, no_arr, no_str)
        if csv:
            print(",".join(str(value) for value in _leaves(shown)), flush=True)
        else:
            print(yaml_text(shown, flow_style) + "---", flush=True)

    with tool_node(_published(name), look_around=not message_type) as node:
        cls = interface_class(message_type or type_of(node, name))
        node.create_subscription(
            cls, name, show, matching_profile(node, name, reliability, durability, depth), raw=raw
        )
        done = spin_while(node, lambda: not (once and seen), timeout_s or None)
    if not done and not seen and timeout_s:
        typer.echo(f"no message on {name} within {timeout_s:g} s", err=True)
        raise typer.Exit(1)


def _leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list):
        return [leaf for item in value for leaf in _leaves(item)]
    return [value]


@app.command("pub")
def publish(
    topic: Name,
    message_type: Annotated[str, typer.Argument(help="Its type.")],
    values: Annotated[str, typer.Argument(help='Values in YAML, such as "{data: 1.0}".')] = "{}",
    rate_hz: Annotated[
        float, typer.Option("--rate", "-r", callback=finite, help="Messages per second.")
    ] = 1.0,
    once: Annotated[bool, typer.Option("--once", "-1", help="One message.")] = False,
    times: Annotated[int, typer.Option("--times", "-t", min=0, help="So many; 0: no end.")] = 0,
    wait: Annotated[
        int,
        typer.Option(
            "--wait-matching-subscriptions", "-w", min=-1, help="Wait for so many; -1: default."
        ),
    ] = -1,
    print_every: Annotated[
        int, typer.Option("--print", "-p", min=0, help="Show every nth; 0: none.")
    ] = 1,
    keep_alive_s: Annotated[
        float,
        typer.Option(
            "--keep-alive", min=0.0, callback=finite, help="Stay after the last message, s."
        ),
    ] = 0.1,
    reliability: Reliability = "",
    durability: Durability = "",
    depth: Depth = 0,
) -> None:
    """Publishes on a topic."""
    if rate_hz <= 0.0:
        raise InputError(f"--rate: is more than 0, found {rate_hz:g}")
    given = parse_values(values)
    with tool_node(look_around=False) as node:
        message = interface_class(message_type)()
        publisher = node.create_publisher(
            type(message), absolute(topic), chosen_profile(reliability, durability, depth)
        )
        count = 1 if once else times
        needed = wait if wait >= 0 else int(bool(count))
        fill(message, given, now=node.get_clock().now().to_msg())
        if needed:
            print(f"Waiting for at least {needed} matching subscription(s)...", flush=True)
            spin_while(node, lambda: publisher.get_subscription_count() < needed)
        print("publisher: beginning loop", flush=True)
        sent = 0
        due = time.monotonic()
        import rclpy

        while rclpy.ok() and (not count or sent < count):
            if sent:
                due += 1.0 / rate_hz
                spin_while(node, lambda: True, max(0.0, due - time.monotonic()))
            fill(message, given, now=node.get_clock().now().to_msg())
            sent += 1
            if print_every and sent % print_every == 0:
                print(f"publishing #{sent}: {message!r}\n", flush=True)
            publisher.publish(message)
        spin_while(node, lambda: True, keep_alive_s)


@app.command("hz")
def hz(
    topic: Name,
    window: Window = 10000,
    seconds: Seconds = 0.0,
) -> None:
    """Measures how often messages come."""
    _measure(topic, rates.Rate(window), seconds)


@app.command("bw")
def bandwidth(
    topic: Name,
    window: Window = 100,
    seconds: Seconds = 0.0,
) -> None:
    """Measures how many bytes come."""
    print(f"Subscribed to [{absolute(topic)}]", flush=True)
    _measure(topic, rates.Bandwidth(window), seconds)


def _measure(topic: str, meter: Any, seconds: float) -> None:
    name = absolute(topic)
    with tool_node(_published(name)) as node:
        cls = interface_class(type_of(node, name))
        profile = matching_profile(node, name, "", "", 1000)
        node.create_subscription(
            cls, name, lambda data: meter.add(time.monotonic(), len(data)), profile, raw=True
        )
        end = time.monotonic() + seconds if seconds else float("inf")
        while time.monotonic() < end:
            spin_while(node, lambda: True, min(1.0, end - time.monotonic()))
            text = meter.text()
            if text:
                print(text, flush=True)
            if not _running():
                return


def _running() -> bool:
    import rclpy

    return bool(rclpy.ok())
