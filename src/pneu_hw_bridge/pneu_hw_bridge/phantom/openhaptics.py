# SPDX-License-Identifier: Apache-2.0
"""Phantom devices through OpenHaptics' HDAPI, whose library the maker's driver brings.

The library runs a thread of its own at the servo rate and calls back in it; between `hdBeginFrame`
and `hdEndFrame` the device is read and its torques are set. Numbers of the parameters are those of
`hdDefines.h` (OpenHaptics 3.4); joint torques are in mN m there.
"""

import ctypes
import threading
from typing import Any

from pneu_hw_bridge.phantom.device import DeviceGoneError, DeviceMissingError, Frame, Tick

LIBRARY = "libHD.so"

CURRENT_ENCODER_VALUES = 0x2010
CURRENT_JOINT_TORQUE = 0x2703
FORCE_OUTPUT = 0x4000
CALLBACK_DONE, CALLBACK_CONTINUE = 0, 1
MOST_PRIORITY = 0xFFFF
INVALID_HANDLE = 0xFFFFFFFF
GONE = (0x0300, 0x0302, 0x0303, 0x0304)
"""Errors after which a device cannot be reached: device fault, communication, its configuration,
timer."""

ENCODERS = 6
"""Values that a device may have; the first three are of the joints with motors."""


class _Error(ctypes.Structure):
    _fields_ = (
        ("code", ctypes.c_uint),
        ("internal", ctypes.c_int),
        ("device", ctypes.c_uint),
    )


_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_void_p)


class OpenHapticsDevice:
    """The device.

    Attributes:
        name: Its name in the driver's configuration; empty for the default one.
        ticks: Calls of the servo thread.
        missed: Always 0: the library does not tell.
    """

    def __init__(self, name: str = "", library: str = LIBRARY) -> None:
        """Opens nothing yet.

        Args:
            name: The device's name.
            library: Path or name of the library.
        """
        self.name = name
        self.ticks = self.missed = 0
        self._path = library
        self._library: Any = None
        self._handle = INVALID_HANDLE
        self._running: int | None = None
        self._callback: Any = None

    def open(self) -> None:
        """Opens it; see `Device`."""
        try:
            lib = ctypes.CDLL(self._path)
            _declare(lib)
        except (OSError, AttributeError) as error:
            raise DeviceMissingError(
                f"library {self._path!r}: OpenHaptics cannot be used ({error}); install the"
                " device's driver and OpenHaptics, or name another device"
            ) from None
        self._library = lib
        self._handle = lib.hdInitDevice(self.name.encode() or None)
        wrong = self._wrong()
        if wrong or self._handle == INVALID_HANDLE:
            self._library = None
            raise DeviceMissingError(
                f"device {self.name or 'default'!r}: OpenHaptics has no such device"
                f" ({wrong or 'invalid handle'})"
            )
        lib.hdMakeCurrentDevice(self._handle)

    def run(self, tick: Tick, rate_hz: float) -> None:
        """Runs the loop in the library's thread; see `Device`.

        Args:
            tick: What is done at each tick.
            rate_hz: Ticks per second.
        """
        lib = self._library
        ended = threading.Event()
        failed: list[BaseException] = []
        counts = (ctypes.c_long * ENCODERS)()
        torque = (ctypes.c_double * 3)()

        def servo(_: Any) -> int:
            try:
                lib.hdBeginFrame(self._handle)
                lib.hdGetLongv(CURRENT_ENCODER_VALUES, counts)
                wanted = tick(Frame((counts[0], counts[1], counts[2]), None))
                torque[:] = [0.0, 0.0, 0.0]
                for k, value in enumerate(wanted or ()):
                    torque[k] = 1e3 * value
                lib.hdSetDoublev(CURRENT_JOINT_TORQUE, torque)
                lib.hdEndFrame(self._handle)
                self.ticks += 1
                if wrong := self._wrong(GONE):
                    raise DeviceGoneError(wrong)
                if wanted is not None:
                    return CALLBACK_CONTINUE
            except BaseException as error:  # told in the thread that waits
                failed.append(error)
            ended.set()
            return CALLBACK_DONE

        self._callback = _CALLBACK(servo)  # kept, as the library calls it
        lib.hdSetSchedulerRate(round(rate_hz))
        if wrong := self._wrong():
            raise DeviceMissingError(
                f"device {self.name or 'default'!r}: a servo rate of {rate_hz:g} Hz is refused"
                f" ({wrong})"
            )
        lib.hdEnable(FORCE_OUTPUT)
        self._running = lib.hdScheduleAsynchronous(self._callback, None, MOST_PRIORITY)
        lib.hdStartScheduler()
        if wrong := self._wrong():
            raise DeviceGoneError(wrong)
        ended.wait()
        lib.hdStopScheduler()
        self._running = None
        if failed:
            raise failed[0]

    def close(self) -> None:
        """Takes torque from the motors and closes it."""
        lib, self._library = self._library, None
        if lib is None:
            return
        lib.hdStopScheduler()
        if self._running is not None:
            lib.hdUnschedule(self._running)
        lib.hdDisable(FORCE_OUTPUT)
        lib.hdDisableDevice(self._handle)
        self._handle = INVALID_HANDLE

    def _wrong(self, only: tuple[int, ...] = ()) -> str:
        """The library's errors since the last call; empty where there were none.

        Args:
            only: Codes of those that count; all unless given.
        """
        told = []
        for _ in range(32):
            error = self._library.hdGetError()
            if not error.code:
                break
            if not only or error.code in only:
                text = self._library.hdGetErrorString(error.code) or b""
                told.append(f"{text.decode(errors='replace')} (0x{error.code:04x})")
        return "; ".join(told)


def _declare(lib: Any) -> None:
    """Types of the functions that are used.

    Raises:
        AttributeError: The library lacks one.
    """
    handle, enum = ctypes.c_uint, ctypes.c_uint
    for name, result, arguments in (
        ("hdInitDevice", handle, [ctypes.c_char_p]),
        ("hdMakeCurrentDevice", None, [handle]),
        ("hdDisableDevice", None, [handle]),
        ("hdEnable", None, [enum]),
        ("hdDisable", None, [enum]),
        ("hdSetSchedulerRate", None, [ctypes.c_ulong]),
        ("hdStartScheduler", None, []),
        ("hdStopScheduler", None, []),
        ("hdScheduleAsynchronous", ctypes.c_ulong, [_CALLBACK, ctypes.c_void_p, ctypes.c_ushort]),
        ("hdUnschedule", None, [ctypes.c_ulong]),
        ("hdBeginFrame", None, [handle]),
        ("hdEndFrame", None, [handle]),
        ("hdGetLongv", None, [enum, ctypes.POINTER(ctypes.c_long)]),
        ("hdSetDoublev", None, [enum, ctypes.POINTER(ctypes.c_double)]),
        ("hdGetError", _Error, []),
        ("hdGetErrorString", ctypes.c_char_p, [ctypes.c_uint]),
    ):
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
