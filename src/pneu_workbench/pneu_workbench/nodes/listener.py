# SPDX-License-Identifier: Apache-2.0
"""A node that listens to a rig for the page, as a process of its own.

It reads one line of JSON, ``{"rig": …, "rate_hz": …, "namespace": …}``, and answers with lines of
their own as things come in: ``{"namespace": …}`` with where the rig is, looked for where none was
given, ``{"window": …}`` with what the model leaves of the newest stretch, ``{"commands": …}``,
``{"status": …}`` from /diagnostics, ``{"alive": …}`` with how many samples came. Then each line
``{"take": seconds, "to": path}`` is answered with ``{"taken": path}`` once the last seconds lie
there as a bag, or with ``{"fault": …}``. It ends with its standard input.
"""

import contextlib
import json
import os
import sys
import threading
import time
from collections import deque
from pathlib import Path
from typing import Any

from pneu_common.errors import InputError
from pneu_runtime import hook
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.nodes.namespaces import namespaces_of, relative_topics
from pneu_sysid.records.write import write_bag
from pneu_sysid.tasks.child import Say, answering
from pneu_sysid.watch import ERROR_TIMES, WARN_TIMES, Verdict, Watch
from pneu_workbench.live.samples import Samples, told_of

TELL_S = 0.05
"""How often it is told what came in."""
FIND_S = 0.2
"""How often the graph is looked at for the rig's topics."""
SHOWN = 8
"""Commands that are told at a time, at least; in between are others."""


def _serve(asked: dict[str, Any], say: Say) -> None:
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.clock import Clock, ClockType
    from rclpy.exceptions import InvalidNamespaceException
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    from pneu_sysid.nodes.watching import Watching

    rig = load_rig(asked["rig"])
    verdict, samples = Verdict(WARN_TIMES, ERROR_TIMES), Samples(rig)
    commands: deque[tuple[str, float, float]] = deque(maxlen=500_000)

    def take() -> None:
        for line in sys.stdin:
            order = json.loads(line)
            try:
                write_bag(Path(order["to"]), rig, samples.last(float(order["take"])))
                say({"taken": order["to"]})
            except InputError as error:
                say({"fault": str(error)})
        os._exit(0)  # whoever asked is gone

    threading.Thread(target=take, daemon=True).start()
    rclpy.init(args=[])
    name = f"workbench_{os.getpid()}"
    node = rclpy.create_node(f"{name}_looks")
    namespace = asked["namespace"] or _found(node, rig, say)
    node.destroy_node()
    say({"namespace": namespace})
    try:
        node = rclpy.create_node(name, namespace=namespace)
    except InvalidNamespaceException as error:
        raise InputError(f"namespace: found {namespace!r} ({error})") from None

    def heard(is_command: bool, name: str, time_s: float, value: float) -> None:
        samples.add(name, time_s, value)
        if is_command:
            commands.append((name, time_s, value))

    watching = Watching(
        node, rig, Watch(rig, float(asked["rate_hz"])), verdict,
        lambda window: say({"window": told_of(window, verdict)}), heard,
    )  # fmt: skip

    def on_status(message: Any) -> None:
        say({"status": [[s.name, _level(s.level), s.message] for s in message.status]})

    node.create_subscription(DiagnosticArray, "/diagnostics", on_status, 10)

    def tell() -> None:
        news: dict[str, list[list[float]]] = {}
        while commands:
            name, time_s, value = commands.popleft()
            news.setdefault(name, []).append([time_s, value])
        if news:
            some = {name: of[:: max(len(of) // SHOWN, 1)] for name, of in news.items()}
            say({"commands": some})
        if watching.failure:
            say({"fault": watching.failure})
        say({"alive": samples.count})

    watching.start()
    # by the machine's time, whatever the graph's does
    node.create_timer(TELL_S, tell, clock=Clock(clock_type=ClockType.STEADY_TIME))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    with contextlib.suppress(ExternalShutdownException):
        executor.spin()


def _found(node: Any, rig: Rig, say: Say) -> str:
    """The namespace in which the rig's topics are; waits until they are in one."""
    told = -1
    while True:
        found = namespaces_of(rig, node.get_topic_names_and_types())
        if len(found) == 1:
            return found[0]
        if len(found) != told:
            told = len(found)
            names = ", ".join(relative_topics(rig))
            where = f"are in several namespaces, {', '.join(found)}: choose one"
            say({"fault": f"{names}: {where if found else 'no node has these topics yet'}"})
        time.sleep(FIND_S)


def _level(level: Any) -> int:
    return level[0] if isinstance(level, bytes) else int(level)


def main() -> None:
    """Serves whoever started this process."""
    lock, raw = threading.Lock(), answering()

    def say(line: dict[str, Any]) -> None:
        with lock:
            raw(line)

    hook.install()
    try:
        _serve(json.loads(sys.stdin.readline()), say)
    except InputError as error:
        say({"fault": str(error)})


if __name__ == "__main__":
    main()
