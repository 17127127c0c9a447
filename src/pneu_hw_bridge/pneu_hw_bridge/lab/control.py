# SPDX-License-Identifier: Apache-2.0
"""The control port of the emulated lab: one JSON object per line, one answer per line."""

import asyncio
import dataclasses
import json
import math
import time
from collections.abc import Mapping
from typing import Any

from pneu_common.errors import InputError
from pneu_hw_bridge.lab.asking import LONGEST_LINE
from pneu_hw_bridge.lab.device import LabDevice
from pneu_hw_bridge.lab.plant import Plant


class Control:
    """Answers requests about a lab; listens on loopback only."""

    def __init__(self, plant: Plant, device: LabDevice) -> None:
        """Prepares; `open` begins to listen.

        Args:
            plant: The lab's plant.
            device: The lab's device.
        """
        self._plant = plant
        self._device = device
        self._server: asyncio.Server | None = None

    async def open(self, port: int) -> int:
        """Begins to listen; returns the port.

        Args:
            port: Port; 0 takes a free one.

        Raises:
            InputError: The port cannot be had.
        """
        try:
            self._server = await asyncio.start_server(
                self._serve, "127.0.0.1", port, limit=LONGEST_LINE
            )
        except OSError as error:
            raise InputError(f"cannot listen on 127.0.0.1:{port} ({error.strerror})") from None
        return int(self._server.sockets[0].getsockname()[1])

    def close(self) -> None:
        """Ends listening."""
        if self._server is not None:
            self._server.close()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while line := await reader.readline():
                writer.write(json.dumps(self._answer(line)).encode() + b"\n")
                await writer.drain()
        except (ValueError, ConnectionError):
            pass  # a line that never ends, or a peer that went: nobody is left to answer
        finally:
            writer.close()

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            if not isinstance(request, dict):
                raise InputError("a request is a JSON object")
            return {"ok": True, **self._carry_out(request)}
        except InputError as error:
            return {"ok": False, "error": str(error)}
        except (ValueError, TypeError) as error:
            return {"ok": False, "error": f"cannot be understood: {error}"}

    def _carry_out(self, request: Mapping[str, Any]) -> dict[str, Any]:
        now_s = time.monotonic()
        what = request.get("do")
        if what == "status":
            return self._status(now_s)
        if what == "history":
            return {"history": [dataclasses.asdict(one) for one in self._device.history]}
        if what == "fault":
            seconds, value = request.get("seconds"), request.get("value")
            active = self._device.faults.begin(
                str(request.get("name")),
                now_s,
                None if seconds is None else float(seconds),
                None if value is None else float(value),
                str(request.get("channel") or ""),
            )
            return {"fault": active.kind.name, "steady_s": now_s}
        if what == "clear":
            return {"cleared": self._device.faults.clear(str(request.get("name") or ""))}
        if what == "stand":
            self._plant.stand()
            return {}
        if what == "go":
            seconds = request.get("seconds")
            self._plant.go(None if seconds is None else float(seconds))
            return {}
        if what == "restart":
            self._device.restart()
            return {}
        known = "status, history, fault, clear, stand, go, restart"
        raise InputError(f"do: found {what!r}, known are {known}")

    def _status(self, now_s: float) -> dict[str, Any]:
        plant = dataclasses.asdict(self._plant.status())
        readings = self._plant.readings() or {}
        encoders = self._plant.rig.encoders
        return {
            "steady_s": now_s,
            "plant": {k: None if _is_nan(v) else v for k, v in plant.items()},
            "failure": self._plant.failure,
            "volts": self._plant.volts(),
            "readings_pa": {n: value for n, value in readings.items() if n not in encoders},
            "encoders": {n: value for n, value in readings.items() if n in encoders},
            "faults": self._device.faults.present(now_s),
            "watchdog": {"tripped": self._device.bitten, "trips": self._device.watchdog_trips},
            "requests": self._device.requests,
            "refused": self._device.refused,
            "safe": [dataclasses.asdict(one) for one in self._device.rests],
            "stalls": [dataclasses.asdict(one) for one in self._device.stalls],
        }


def _is_nan(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)
