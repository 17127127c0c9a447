# SPDX-License-Identifier: Apache-2.0
"""What a bridge must still know when it is started again: that it was stopped, tripped, or killed.

One small file per bridge and device. While valves may be driven it says so; a bridge that finds
that its predecessor never took it back knows that it was killed.
"""

import contextlib
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from pneu_common.files import replacing
from pneu_common.text import one_line
from pneu_hw_bridge.safety.supervisor import Latches

FOLDER_VARIABLE = "PNEU_STATE_DIR"
"""Environment variable that names another folder."""

KILLED = "the bridge before was killed, or the machine went down, while it drove the valves"


@dataclass(frozen=True)
class Remembered:
    """What is kept.

    Attributes:
        bridge: Full name of the node.
        device: Where the device is reached.
        e_stop: Who called for the emergency stop; empty where it is not set.
        trip: What tripped it; empty where nothing did.
        driving: Whether commands may be followed.
    """

    bridge: str
    device: str
    e_stop: str = ""
    trip: str = ""
    driving: bool = False


def folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Returns the folder of the files, by the XDG Base Directory Specification.

    Args:
        environment: The variables ``PNEU_STATE_DIR``, ``XDG_STATE_HOME`` and ``HOME`` are read.
    """
    if environment.get(FOLDER_VARIABLE):
        return Path(environment[FOLDER_VARIABLE])
    home = environment.get("XDG_STATE_HOME") or os.path.expanduser("~/.local/state")
    return Path(home) / "pneu"


class Memory:
    """The file of one bridge and device."""

    def __init__(self, bridge: str, device: str, where: Path | None = None) -> None:
        """Finds its name; `recall` and `keep` do the rest.

        Args:
            bridge: Full name of the node.
            device: Where the device is reached.
            where: Folder; None is the user's.
        """
        self._last = Remembered(bridge, device)
        key = hashlib.sha256(f"{bridge}\n{device}".encode()).hexdigest()[:16]
        self.path = (where or folder()) / "bridges" / f"{key}.json"

    def recall(self) -> Latches:
        """Returns what was latched when the bridge before ended, or that it never ended itself.

        A file that cannot be understood counts as a stop: it was being written, or is damaged.
        """
        try:
            found = json.loads(self.path.read_text(encoding="utf-8"))
            last = Remembered(**found)
        except FileNotFoundError:
            return Latches()
        except (OSError, ValueError, TypeError) as error:
            return Latches(e_stop=f"{self.path} cannot be read ({error})")
        self._last = last
        e_stop, trip = (one_line(text) if text else "" for text in (last.e_stop, last.trip))
        return Latches(e_stop=e_stop or (KILLED if last.driving else ""), trip=trip)

    def keep(self, latches: Latches, driving: bool) -> None:
        """Writes what is to be known next time, where it has changed.

        Args:
            latches: Emergency stop and trip.
            driving: Whether commands may be followed.

        Raises:
            OSError: It cannot be written.
        """
        now = Remembered(
            self._last.bridge, self._last.device, latches.e_stop, latches.trip, driving
        )
        if now == self._last:
            return
        if now == Remembered(now.bridge, now.device):
            with contextlib.suppress(FileNotFoundError):
                self.path.unlink()
        else:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(self.path) as aside, aside.open("w", encoding="utf-8") as stream:
                json.dump(asdict(now), stream)
                stream.flush()
                os.fsync(stream.fileno())
        self._last = now
