# SPDX-License-Identifier: Apache-2.0
"""Running the processes of a launch: output, signals, respawn, exit status.

Each process is the leader of its own group, so that Ctrl-C reaches the launch alone, which then
passes it on: SIGINT first, SIGTERM to those that stay, SIGKILL to those that still stay.
"""

import contextlib
import os
import selectors
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import TextIO

from pneu_graph.launch.guard import Guard, on_death_of_parent
from pneu_graph.launch.process_spec import ProcessSpec

LONGEST_WAIT_S = 0.5
"""How long the loop sleeps at most, s; signals wake it earlier."""

READ_BYTES = 65536


class _Process:
    """A process of the launch, over all its starts."""

    def __init__(self, spec: ProcessSpec, start_at: float) -> None:
        self.spec = spec
        self.start_at: float | None = start_at
        self.running: subprocess.Popen[bytes] | None = None
        self.partial = {"stdout": b"", "stderr": b""}
        self.open_streams = 0
        self.starts = 0
        self.escalate_at: float | None = None
        self.next_signal = signal.SIGINT


class Supervisor:
    """Runs processes until all have ended.

    Args:
        specs: The processes.
        screen: Where output is shown.
        log: File for all output; None: none.
    """

    def __init__(
        self, specs: list[ProcessSpec], screen: TextIO = sys.stdout, log: TextIO | None = None
    ) -> None:
        self._screen = screen
        self._log = log
        self._processes = [_Process(spec, spec.delay_s) for spec in specs]
        self._selector = selectors.DefaultSelector()
        self._before_program: Callable[[], None] | None = None
        self._guard: Guard | None = None
        self._shutting_down = False
        self._asked = 0
        self._failed = False

    def run(self) -> int:
        """Runs everything; to be called in the main thread.

        Returns:
            0 where every process ended well or by our signal, else 1.
        """
        waking, woken = os.pipe()
        os.set_blocking(waking, False)
        os.set_blocking(woken, False)
        self._selector.register(waking, selectors.EVENT_READ)
        self._guard = Guard()
        self._before_program = on_death_of_parent()
        handlers = {
            number: signal.signal(number, self._on_signal)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        }
        handlers[signal.SIGCHLD] = signal.signal(signal.SIGCHLD, lambda number, frame: None)
        previous = signal.set_wakeup_fd(woken, warn_on_full_buffer=False)
        begin = time.monotonic()
        try:
            for process in self._processes:
                process.start_at = begin + process.spec.delay_s
            while self._unfinished():
                self._step(waking)
        finally:
            self._kill_rest()
            signal.set_wakeup_fd(previous)
            for number, handler in handlers.items():
                signal.signal(number, handler)
            self._selector.close()
            os.close(waking)
            os.close(woken)
            self._guard.close()
        return 1 if self._failed else 0

    def _unfinished(self) -> bool:
        return any(
            p.running is not None or p.start_at is not None or p.open_streams
            for p in self._processes
        )

    def _step(self, waking: int) -> None:
        now = time.monotonic()
        for process in self._processes:
            if process.start_at is not None and now >= process.start_at:
                process.start_at = None
                self._start(process)
            if process.escalate_at is not None and now >= process.escalate_at:
                self._escalate(process)
        times = [p.start_at for p in self._processes] + [p.escalate_at for p in self._processes]
        next_s = min((t - now for t in times if t is not None), default=LONGEST_WAIT_S)
        for key, _ in self._selector.select(max(0.0, min(next_s, LONGEST_WAIT_S))):
            if key.fd == waking:
                with contextlib.suppress(BlockingIOError):
                    os.read(waking, READ_BYTES)
            else:
                self._read(key)
        if self._asked:
            self._on_request()
        for process in self._processes:
            if process.running is not None and process.running.poll() is not None:
                self._ended(process, process.running)

    def _start(self, process: _Process) -> None:
        spec = process.spec
        process.starts += 1
        process.next_signal = signal.SIGINT
        try:
            process.running = running = subprocess.Popen(
                spec.command[0] if spec.shell else spec.command,
                shell=spec.shell,
                env=spec.environment,
                cwd=spec.directory,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                process_group=0,
                preexec_fn=self._before_program,
            )
        except OSError as error:
            self._failed = True
            self._say("ERROR", spec.label, f"cannot be started: {error.filename}: {error.strerror}")
            if spec.shutdown_on_exit:
                self._shut_down("process could not be started")
            return
        assert self._guard is not None
        assert running.stdout is not None and running.stderr is not None
        self._guard.add(running.pid, [running.stdout.fileno(), running.stderr.fileno()])
        for name, stream in (("stdout", running.stdout), ("stderr", running.stderr)):
            os.set_blocking(stream.fileno(), False)
            self._selector.register(stream, selectors.EVENT_READ, (process, name))
            process.open_streams += 1
        self._say("INFO", spec.label, f"process started with pid [{running.pid}]")

    def _read(self, key: selectors.SelectorKey) -> None:
        process, name = key.data
        try:
            data = os.read(key.fd, READ_BYTES)
        except BlockingIOError:
            return
        if not data:
            self._close_stream(key)
            return
        *lines, process.partial[name] = (process.partial[name] + data).split(b"\n")
        for line in lines:
            self._show(process, name, line)

    def _close_stream(self, key: selectors.SelectorKey) -> None:
        process, name = key.data
        if process.partial[name]:
            self._show(process, name, process.partial[name])
            process.partial[name] = b""
        self._selector.unregister(key.fileobj)
        key.fileobj.close()  # type: ignore[union-attr]
        process.open_streams -= 1

    def _show(self, process: _Process, name: str, line: bytes) -> None:
        text = f"[{process.spec.label}] {line.decode(errors='backslashreplace')}"
        self._write(text, name in process.spec.screen)

    def _ended(self, process: _Process, running: subprocess.Popen[bytes]) -> None:
        spec = process.spec
        process.running = None
        process.escalate_at = None
        assert self._guard is not None
        # What it has started itself goes with it; only then can its pipes come to their end.
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(running.pid, signal.SIGTERM)
        self._guard.remove(running.pid)
        for key in list(self._selector.get_map().values()):
            if key.data is not None and key.data[0] is process:
                self._read(key)
        for key in list(self._selector.get_map().values()):
            if key.data is not None and key.data[0] is process:
                self._close_stream(key)
        code = running.returncode
        if code == 0:
            self._say("INFO", spec.label, f"process has finished cleanly [pid {running.pid}]")
        else:
            # One that we have asked to go has not failed, whatever it answers to a signal.
            self._failed = self._failed or not self._shutting_down
            self._say(
                "ERROR",
                spec.label,
                f"process has died [pid {running.pid}, exit code {code},"
                f" cmd '{shlex.join(spec.command)}'].",
            )
        if self._shutting_down:
            return
        again = spec.respawn_max_retries < 0 or process.starts <= spec.respawn_max_retries
        if spec.respawn and again:
            self._failed = False if code == 0 else self._failed
            process.start_at = time.monotonic() + spec.respawn_delay_s
        elif spec.shutdown_on_exit:
            self._shut_down(f"process [{spec.label}] ended")

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._asked = number

    def _on_request(self) -> None:
        number, self._asked = self._asked, 0
        if self._shutting_down:
            self._say("WARNING", "launch", "asked again, escalating")
            for process in self._processes:
                if process.running is not None:
                    self._escalate(process)
            return
        if number == signal.SIGINT:
            self._say("WARNING", "launch", "user interrupted with ctrl-c (SIGINT)")
        else:
            self._say("WARNING", "launch", f"received {signal.Signals(number).name}")
        self._shut_down("")

    def _shut_down(self, reason: str) -> None:
        if reason:
            self._say("INFO", "launch", f"{reason}, shutting down")
        self._shutting_down = True
        for process in self._processes:
            process.start_at = None
            if process.running is not None:
                self._escalate(process)

    def _escalate(self, process: _Process) -> None:
        """Sends the next stronger signal."""
        running, spec = process.running, process.spec
        process.escalate_at = None
        if running is None:
            return
        number = process.next_signal
        if number == signal.SIGINT:
            wait_s, process.next_signal = spec.sigterm_timeout_s, signal.SIGTERM
        else:
            before = "SIGINT" if number == signal.SIGTERM else "SIGTERM"
            waited = spec.sigterm_timeout_s if number == signal.SIGTERM else spec.sigkill_timeout_s
            self._say(
                "ERROR",
                spec.label,
                f"process[{spec.label}] failed to terminate '{waited:g}' seconds after receiving"
                f" '{before}', escalating to '{number.name}'",
            )
            wait_s, process.next_signal = spec.sigkill_timeout_s, signal.SIGKILL
        self._say("INFO", spec.label, f"sending signal '{number.name}' to process[{spec.label}]")
        with contextlib.suppress(ProcessLookupError):
            os.killpg(running.pid, number)
        if number != signal.SIGKILL:
            process.escalate_at = time.monotonic() + wait_s

    def _kill_rest(self) -> None:
        """After a fault of our own: nothing may stay behind."""
        for process in self._processes:
            if process.running is not None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.running.pid, signal.SIGKILL)
                process.running.wait()

    def _say(self, level: str, who: str, what: str) -> None:
        self._write(f"[{level}] [{who}]: {what}", True)

    def _write(self, line: str, on_screen: bool) -> None:
        if on_screen:
            with contextlib.suppress(BrokenPipeError):  # the reader has gone, we go on
                print(line, file=self._screen, flush=True)
        if self._log is not None:
            try:
                print(f"{time.time():.6f} {line}", file=self._log, flush=True)
            except OSError as error:  # such as a full disk, for which no robot has to stop
                self._log = None
                self._say("ERROR", "launch", f"the log ends here: {error.strerror}")
