# SPDX-License-Identifier: Apache-2.0
"""Talking to the control port of a running lab, from another process."""

import json
import socket
from collections.abc import Mapping
from typing import Any

from pneu_common.errors import InputError

MODBUS_PORT = 1502
CONTROL_PORT = 1503

LONGEST_LINE = 65536
"""Longest request, bytes."""


def ask(port: int, request: Mapping[str, Any], timeout_s: float = 5.0) -> dict[str, Any]:
    """Sends one request to the control port of a running lab and returns its answer.

    Args:
        port: The control port.
        request: The request.
        timeout_s: Longest wait, s.

    Raises:
        InputError: No lab answers there, or it refuses.
    """
    try:
        with socket.create_connection(("127.0.0.1", port), timeout_s) as connection:
            connection.sendall(json.dumps(dict(request)).encode() + b"\n")
            with connection.makefile("rb") as stream:
                line = stream.readline(LONGEST_LINE * 4)
        answer = json.loads(line)
    except (OSError, ValueError):
        raise InputError(f"no lab answers on control port {port} of this machine") from None
    if not answer.get("ok"):
        raise InputError(str(answer.get("error")))
    return dict(answer)
