# SPDX-License-Identifier: Apache-2.0
"""On what the gas of batches of rigs is computed: one setting for all that runs them.

``PNEU_DEVICE`` in the environment is ``cpu``, ``cuda`` (an NVIDIA GPU, double precision) or
``cuda32`` (single). Where there is no such GPU the processor is used, and one line of the log says
so.
"""

import functools
import logging
import os
from enum import StrEnum

from pneu_common.errors import InputError
from pneu_common.log import LOG

VARIABLE = "PNEU_DEVICE"


class Device(StrEnum):
    """On what a batch is computed."""

    CPU = "cpu"
    CUDA = "cuda"
    CUDA32 = "cuda32"


def chosen() -> Device:
    """The device that the environment asks for, or the processor where it is not there.

    Raises:
        InputError: There is no such kind of device.
    """
    return _found(os.environ.get(VARIABLE, Device.CPU))


@functools.cache
def _found(name: str) -> Device:
    """The device of a name; what is missing is said once."""
    if name not in list(Device):
        allowed = ", ".join(Device)
        raise InputError(f"{VARIABLE}: found {name!r}; allowed are {allowed}")
    if name == Device.CPU:
        return Device.CPU
    try:
        from pneu_sim.cuda.launch import missing

        why = missing()
    except ImportError as problem:
        why = f"numba-cuda cannot be used ({problem})"
    if why:
        logging.getLogger(LOG).warning(
            f"{VARIABLE} is {name!r}, but {why}: computing on the processor"
        )
        return Device.CPU
    return Device(name)
