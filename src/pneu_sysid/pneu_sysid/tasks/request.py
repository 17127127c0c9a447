# SPDX-License-Identifier: Apache-2.0
"""What a task is asked for, and what came of it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pneu_common.errors import InputError

TASKS = ("fit", "compare", "diagnose", "learn", "look", "suspect", "add")
FOLDERS = ("learn", "look", "suspect", "add")
"""Those that write a folder, which must be new."""

Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class Request:
    """What is asked for.

    Attributes:
        task: One of ``TASKS``.
        bag: Recording.
        rig: Rig file.
        output: What is written: a rig file (fit), a report (compare, diagnose), a folder (others).
        aside: Folder for work in progress, on the same disk as the output; made and removed.
        workers: Threads; 0 is all cores.
        more_bags: Further recordings of the same rig.
        added: How many of the rig's effects, its last ones, are fitted together (add).
        kept_aside: Parts that are kept aside for judging, from and to, s of the recordings one
            after the other (look, suspect, add); every third stretch unless there is one.
    """

    task: str
    bag: str
    rig: str
    output: str
    aside: str
    workers: int = 0
    more_bags: tuple[str, ...] = ()
    added: int = 1
    kept_aside: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What came of it.

    Attributes:
        success: Whether the output is there.
        message: Why not.
        verdict: Of ``diagnose``, ``suspect`` and ``learn``.
        result_file: JSON of the result.
    """

    success: bool
    message: str = ""
    verdict: str = ""
    result_file: str = ""


def check(request: Request) -> None:
    """Raises InputError where it can be told beforehand that a request will fail.

    Args:
        request: The request.
    """
    if request.task not in TASKS:
        raise InputError(f"task: found {request.task!r}, allowed are {', '.join(TASKS)}")
    for name in ("bag", "rig"):
        if not Path(getattr(request, name)).exists():
            raise InputError(f"{name}: found {getattr(request, name)!r}, there is no such file")
    for bag in request.more_bags:
        if not Path(bag).exists():
            raise InputError(f"more_bags: found {bag!r}, there is no such file")
    if not request.output:
        raise InputError("output: found nothing, a path is needed")
    output = Path(request.output)
    if not output.absolute().parent.is_dir():
        raise InputError(f"output: folder {output.absolute().parent} does not exist")
    if request.task in FOLDERS and output.exists():
        raise InputError(f"output: {output} exists already; task {request.task} writes a new one")
    if request.task not in FOLDERS and output.is_dir():
        raise InputError(f"output: {output} is a folder, a file is needed")
    if request.added < 1:
        raise InputError(f"added: found {request.added}, allowed is 1 or more")
