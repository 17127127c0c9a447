# SPDX-License-Identifier: Apache-2.0
"""Asks every node of the graph for its parameters, once, without ever waiting."""

import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters

from pneu_graph.bag.bag_writer import Attachment
from pneu_graph.tools.message_text import yaml_text
from pneu_graph.tools.parameter_value import python_value


class ParameterCollector:
    """Collects parameters as attachments ``parameters/<node>.yaml`` in the form of a params file.

    Args:
        node: Node that asks.
        keep: Told each attachment.
    """

    def __init__(self, node: Any, keep: Callable[[Attachment], None]) -> None:
        self._node = node
        self._keep = keep
        self._asked: set[str] = set()
        self._pending: dict[str, Any] = {}

    def look(self) -> None:
        """Asks nodes that are new and can answer."""
        for name, namespace in self._node.get_node_names_and_namespaces():
            full = f"{namespace.rstrip('/')}/{name}"
            own = full == self._node.get_fully_qualified_name()
            if full in self._asked or own or name.startswith("_"):
                continue
            client = self._pending.get(full)
            if client is None:
                client = self._node.create_client(ListParameters, f"{full}/list_parameters")
                self._pending[full] = client
            if client.service_is_ready():
                self._asked.add(full)
                future = client.call_async(ListParameters.Request())
                future.add_done_callback(lambda done, full=full: self._listed(full, done))

    def _listed(self, full: str, done: Any) -> None:
        self._node.destroy_client(self._pending.pop(full))
        response = done.result()
        if response is None:
            return
        names = list(response.result.names)
        client = self._node.create_client(GetParameters, f"{full}/get_parameters")
        self._pending[full] = client
        future = client.call_async(GetParameters.Request(names=names))
        future.add_done_callback(lambda done: self._answered(full, names, done))

    def _answered(self, full: str, names: list[str], done: Any) -> None:
        self._node.destroy_client(self._pending.pop(full))
        response = done.result()
        if response is None:
            return
        values = {n: python_value(v) for n, v in zip(names, response.values, strict=False)}
        text = yaml_text({full: {"ros__parameters": values}})
        name = f"parameters/{full.lstrip('/')}.yaml"
        self._keep(Attachment(name, text.encode(), "application/yaml", time.time_ns()))
