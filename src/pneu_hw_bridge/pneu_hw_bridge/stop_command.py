# SPDX-License-Identifier: Apache-2.0
"""The subcommand `pneu stop`; it imports little, for somebody waits."""

import time
from collections.abc import Sequence
from typing import Any

from pneu_hw_bridge.stopping import stop_here

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
    answers, silent = stop_here(reason)
    for answer in answers:
        _show(answer)
    if silent:
        print(f"NOT CONFIRMED: {silent} bridges of this machine gave no answer")
    if not local:
        answers += _stop_on_graph({answer["bridge"] for answer in answers})
    if not answers and not silent:
        print("no bridge found" + (" on this machine" if local else ""))
    return int(bool(silent) or not answers or not all(answer["safe"] for answer in answers))


def _show(answer: dict[str, Any]) -> None:
    state = "safe" if answer["safe"] else "NOT CONFIRMED"
    print(f"{answer['bridge']}: {state}, {answer['message']}", flush=True)


def _stop_on_graph(known: set[str]) -> list[dict[str, Any]]:
    """Calls the service of all bridges on the graph but those that have answered."""
    from pneu_runtime import hook

    hook.install()
    import rclpy

    rclpy.init(args=[])
    try:
        return _call_services(rclpy.create_node("pneu_stop"), known)
    finally:
        rclpy.try_shutdown()


def _call_services(node: Any, known: set[str]) -> list[dict[str, Any]]:
    """Calls them while they are discovered. Who is found and does not answer is not confirmed."""
    import rclpy
    from std_srvs.srv import Trigger

    from pneu_graph.nodes.discovery import patience_s

    found: dict[str, dict[str, Any]] = {}
    clients: dict[str, Any] = {}  # kept: a new one would have to be discovered anew
    asked: dict[str, Any] = {}

    def answer(bridge: str, safe: bool, message: str) -> None:
        found[bridge] = {"bridge": bridge, "safe": safe, "message": message}
        _show(found[bridge])

    end_s = time.monotonic() + LOOKS * patience_s()
    while (now_s := time.monotonic()) < end_s or (
        len(found) < len(clients) and now_s < end_s + ANSWER_S
    ):
        for name, kinds in node.get_service_names_and_types():
            bridge = name.removesuffix("/e_stop")
            if name != bridge and "std_srvs/srv/Trigger" in kinds and bridge not in known:
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
