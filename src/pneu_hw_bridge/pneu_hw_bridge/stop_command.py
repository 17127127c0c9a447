# SPDX-License-Identifier: Apache-2.0
"""The subcommand `pneu stop`; it imports little, for somebody waits."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from pneu_common.text import one_line
from pneu_hw_bridge.stopping import Answer, stop_here

LOOKS = 2.0
"""Bridges of other machines are looked for this many times as long as discovery usually takes."""
ANSWER_S = 3.0
"""How long a bridge that was found may take to answer, s."""


def at_once(words: Sequence[str]) -> int | None:
    """Runs the subcommand before the libraries of the command line are imported.

    Args:
        words: What follows on the command line.

    Returns:
        The exit status; None where the words need more than this understands.
    """
    left = [word for word in words if word != "--local"]
    reason = "pneu stop"
    if len(left) == 2 and left[0] == "--reason":
        reason, left = left[1], []
    return None if left else stop(reason, "--local" in words)


def stop(reason: str, local: bool) -> int:
    """Stops all bridges, those of this machine first; returns the exit status.

    Args:
        reason: Who calls for it.
        local: Whether only those of this machine are meant.
    """
    answers = []
    try:
        answers = stop_here(reason)
    except Exception as error:  # the graph has to be called, whatever is wrong here
        answers.append(Answer("this machine", False, one_line(f"{type(error).__name__}: {error}")))
    for answer in answers:
        _show(answer)
    if not local:
        # also of those that have answered: who owns the valves is known there by another way
        known = {answer.bridge: answer for answer in answers}
        for answer in _stop_on_graph(known):
            if answer.safe and answer.bridge in known:  # what it had not confirmed before
                answers.remove(known[answer.bridge])
            answers.append(answer)
    if not answers:
        print("no bridge found" + (" on this machine" if local else ""))
    return int(not answers or not all(answer.safe for answer in answers))


def _show(answer: Answer) -> None:
    state = "safe" if answer.safe else "NOT CONFIRMED"
    print(f"{answer.bridge}: {state}, {answer.message}", flush=True)


def _stop_on_graph(known: Mapping[str, Answer]) -> list[Answer]:
    """Calls the service of all bridges on the graph; those known to be safe are shown no more."""
    from pneu_runtime import hook

    hook.install()
    import rclpy

    rclpy.init(args=[])
    try:
        return _call_services(rclpy.create_node("pneu_stop"), known)
    finally:
        rclpy.try_shutdown()


def _call_services(node: Any, known: Mapping[str, Answer]) -> list[Answer]:
    """Calls them while they are discovered. Who is found and does not answer is not confirmed."""
    import rclpy
    from std_srvs.srv import Trigger

    from pneu_graph.nodes.discovery import patience_s

    found: dict[str, Answer] = {}
    clients: dict[str, Any] = {}  # kept: a new one would have to be discovered anew
    asked: dict[str, Any] = {}

    def answer(bridge: str, safe: bool, message: str) -> None:
        found[bridge] = Answer(one_line(bridge), safe, one_line(message))
        if not (safe and bridge in known and known[bridge].safe):
            _show(found[bridge])

    end_s = time.monotonic() + LOOKS * patience_s()
    while (now_s := time.monotonic()) < end_s or (
        len(found) < len(clients) and now_s < end_s + ANSWER_S
    ):
        for name, kinds in node.get_service_names_and_types():
            bridge = name.removesuffix("/e_stop")
            if name != bridge and "std_srvs/srv/Trigger" in kinds:
                if bridge not in clients:
                    clients[bridge] = node.create_client(Trigger, name)
                if bridge not in asked and clients[bridge].service_is_ready():
                    asked[bridge] = clients[bridge].call_async(Trigger.Request())
        rclpy.spin_once(node, timeout_sec=0.05)
        for bridge, future in asked.items():
            if bridge not in found and future.done():
                reply = future.result()
                answer(bridge, reply.success, reply.message)
    for bridge in clients.keys() - found.keys():
        answer(bridge, False, "no answer" if bridge in asked else "its service is not reached")
    return list(found.values())
