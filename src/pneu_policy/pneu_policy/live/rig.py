# SPDX-License-Identifier: Apache-2.0
"""The emulated lab with its bridge on a graph of its own, and runs of controllers on it.

The lab, with the effects its rig file does not know, and the bridge stay up for all runs. Each run
has a recorder and a controller of its own, both processes, and a target that begins at its time
zero once they are there. Before a run nothing is commanded, so that the bridge has vented the rig:
all begin at the room's pressure. Whatever happens, nothing is left running.
"""

import contextlib
import json
import os
import random
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneu_common.children import python
from pneu_common.errors import InputError
from pneu_graph.launch.guard import on_death_of_parent
from pneu_graph.tools.executables import command_of
from pneu_hw_bridge.lab.asking import ask
from pneu_policy.judge.metrics import EARLY_S
from pneu_policy.judge.tasks import NOISE_PA, Tasks
from pneu_policy.live.bag import DIAGNOSTICS, NAMESPACE, LateError
from pneu_policy.task.targets import Target
from pneu_runtime import hook
from pneu_sim.rig import load_rig, save_rig

RATE_HZ = 500.0
"""Of the bus and of the readings."""
TARGET_STEP_S = 0.01
"""Between the values, and the messages, of the target."""
PREVIEW_S = 0.5
READY_S = 120.0
"""How long the lab may take; the first time it compiles its kernels."""
START_S = 20.0
END_S = 15.0
REST_S = 0.5
"""Least time without commands before the processes of a run start, in which the rig vents."""


@dataclass(frozen=True)
class LivePlant:
    """An emulated lab.

    Attributes:
        name: What to call it.
        rig: Rig file.
        sealed: File with hidden effects; None hides nothing.
        dx_m: Cell length of the plant, m; None is half of the rig file's.
        noise_pa: Noise of its sensors, one sigma, Pa. Without any the bridge would take their
            readings for frozen.
        seed: Seed of the noise.
    """

    name: str
    rig: Path
    sealed: Path | None = None
    dx_m: float | None = None
    noise_pa: float = NOISE_PA
    seed: int = 0


def _ready_to_end() -> Callable[[], None]:
    """What a child runs before its program: it ends with us, and can be interrupted.

    A shell starts jobs in the background with SIGINT ignored, and children inherit that.
    """
    guard = on_death_of_parent()

    def prepare() -> None:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        if guard is not None:
            guard()

    return prepare


class _Process:
    """A process in a group of its own, which ends with us and is ended as by Ctrl-C."""

    def __init__(self, name: str, command: Sequence[str], env: Mapping[str, str], log: Path):
        self.name, self._log = name, log
        with log.open("wb") as stream:
            self._process = subprocess.Popen(
                list(command),
                stdin=subprocess.DEVNULL,
                stdout=stream,
                stderr=stream,
                env=dict(env),
                start_new_session=True,
                preexec_fn=_ready_to_end(),
            )

    def check(self) -> None:
        """Raises where it has ended by itself."""
        status = self._process.poll()
        if status is None:
            return
        lines = self._log.read_text(errors="replace").strip().splitlines()
        text = f"{self.name} ended with status {status}: {lines[-1] if lines else 'no word'}"
        raise InputError(text) if status == 2 else LateError(text)

    def interrupt(self) -> None:
        """Asks it to end, as by Ctrl-C."""
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGINT)

    def end(self) -> None:
        """Interrupts it, and kills what is left after a while."""
        self.interrupt()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


class LiveRig:
    """A lab with its bridge, and what runs are started with; a context manager."""

    def __init__(self, plant: LivePlant, tap: str, folder: Path) -> None:
        """Takes what it is to be; entering starts it.

        Args:
            plant: The lab.
            tap: Tap that is controlled.
            folder: Where logs and bags go.
        """
        self.plant, self.tap, self.folder = plant, tap, folder
        self._stack = contextlib.ExitStack()
        self._domain = random.SystemRandom().randint(1, 100)
        self._env = {
            **os.environ,
            "ROS_DOMAIN_ID": str(self._domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        self._standing: list[_Process] = []
        self._control_port = 0

    def __enter__(self) -> "LiveRig":
        """Starts lab, bridge and probe.

        Raises:
            InputError: They do not come up.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        try:
            self._start()
        except LateError as error:  # there is no run yet that could be repeated
            self._stack.close()
            raise InputError(f"lab {self.plant.name!r}: {error}; see {self.folder}") from None
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Ends them all."""
        self._stack.close()

    def _write_rig(self) -> Path:
        """The rig with its topics where this graph has them, whatever its recordings have."""
        rig = load_rig(self.plant.rig)
        for command in rig.commands.values():
            command.channel = None
        for tap in rig.taps.values():
            tap.channel = None
        path = self.folder / "rig.yaml"
        save_rig(rig, path)
        return path

    def _start(self) -> None:
        self._rig = self._write_rig()
        scratch = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
        ready = scratch / "ready.json"
        lab = python("pneu_common.cli", "lab", "--rig", str(self.plant.rig))
        lab += ["--port", "0", "--control-port", "0", "--ready-file", str(ready)]
        lab += ["--seed", str(self.plant.seed), "--noise", str(self.plant.noise_pa)]
        if self.plant.sealed is not None:
            lab += ["--sealed", str(self.plant.sealed)]
        if self.plant.dx_m is not None:
            lab += ["--dx", str(self.plant.dx_m)]
        self._standing.append(self._enter("lab", lab))
        self._wait(ready.exists, READY_S, "the lab to be ready")
        ports = json.loads(ready.read_text(encoding="utf-8"))
        self._control_port = ports["control_port"]
        self._join_graph()
        bridge = self._node(
            "pneu_hw_bridge",
            "valve_bridge",
            rig=str(self._rig.resolve()),
            port=ports["modbus_port"],
            rate_hz=RATE_HZ,
            publish_rate_hz=RATE_HZ,
            autostart=True,
        )
        self._standing.append(self._enter("valve_bridge", bridge))
        topic = f"/{NAMESPACE}/taps/{self.tap}/pressure"
        self._wait(lambda: self._probe.count_publishers(topic) == 1, START_S, f"topic {topic}")

    def _join_graph(self) -> None:
        hook.install()
        import rclpy
        from rclpy.context import Context
        from rclpy.node import Node

        with _environment(self._env):
            self._context = Context()
            rclpy.init(args=[], context=self._context, domain_id=self._domain)
            self._stack.callback(self._context.try_shutdown)
            self._probe = Node("evaluation", namespace=NAMESPACE, context=self._context)
            self._stack.callback(self._probe.destroy_node)

    def _spin(self, nodes: Sequence[Any], stack: contextlib.ExitStack) -> None:
        """Has nodes served by a thread for as long as the stack is open."""
        from rclpy.executors import SingleThreadedExecutor

        executor = SingleThreadedExecutor(context=self._context)
        for node in nodes:
            executor.add_node(node)
        thread = threading.Thread(target=executor.spin, daemon=True)
        thread.start()
        stack.callback(thread.join, 5.0)
        stack.callback(executor.shutdown)

    def _node(self, package: str, executable: str, **parameters: Any) -> list[str]:
        """Command line of a node."""
        words = [*command_of(package, executable), "--ros-args", "-r", f"__ns:=/{NAMESPACE}"]
        for name, value in parameters.items():
            text = json.dumps(value) if not isinstance(value, str) else value
            words += ["-p", f"{name}:={text}"]
        return words

    def _enter(
        self, name: str, command: Sequence[str], stack: contextlib.ExitStack | None = None
    ) -> _Process:
        process = _Process(name, command, self._env, self.folder / f"{name}.log")
        (stack or self._stack).callback(process.end)
        return process

    def _wait(
        self,
        condition: Callable[[], bool],
        seconds: float,
        what: str,
        others: Sequence[_Process] = (),
    ) -> None:
        """Waits until something has come about, while all processes run."""
        end = time.monotonic() + seconds
        while not condition():
            for process in (*self._standing, *others):
                process.check()
            if time.monotonic() > end:
                raise LateError(f"waited {seconds:g} s for {what}")
            time.sleep(0.02)

    def status(self) -> dict[str, Any]:
        """How the lab is doing."""
        return ask(self._control_port, {"do": "status"})

    def record(self, controller: Path, tasks: Tasks, target: Target, bag: Path) -> None:
        """One run of a controller, recorded.

        Args:
            controller: Its file.
            tasks: For the length of the run.
            target: The target.
            bag: Folder of the recording; must not exist.

        Raises:
            LateError: The machine did not keep up, or a process failed.
            InputError: The controller refuses the rig.
        """
        topics = [self._topic(name) for name in (f"taps/{self.tap}/pressure", "valve/command")]
        topics += [self._topic("valve/applied"), self._topic("target"), DIAGNOSTICS]
        skipped_s = self.status()["plant"]["skipped_s"]
        with contextlib.ExitStack() as stack:
            node = self._target_node(target, stack)
            recorder = self._node("pneu_graph", "recorder", uri=str(bag), topics=topics)
            policy = self._node(
                "pneu_policy",
                "policy",
                policy=str(controller.resolve()),
                rig=str(self._rig.resolve()),
                target_timeout_s=0.25,
                autostart=True,
            )
            own = [self._enter("recorder", recorder, stack)]
            own.append(self._enter("controller", policy, stack))

            def complete() -> bool:
                probe = self._probe
                heard = probe.count_subscribers(self._topic("target")) >= 2
                commanded = probe.count_publishers(self._topic("valve/command")) == 1
                return (
                    heard
                    and commanded
                    and all(probe.count_subscribers(topic) >= 1 for topic in topics[:3])
                )

            self._wait(complete, START_S, "recorder and controller", own)
            time.sleep(0.1)  # for the last subscription to be matched on both sides
            # From its first turn on the target's time runs.
            self._spin([node], stack)
            end = time.monotonic() + tasks.duration_s + EARLY_S + 0.15
            while time.monotonic() < end:
                for process in (*self._standing, *own):
                    process.check()
                time.sleep(0.1)
            for process in own:  # all at once; each is waited for below
                process.interrupt()
        gone = time.monotonic()
        self._wait(
            lambda: self._probe.count_publishers(self._topic("valve/command")) == 0,
            START_S,
            "the controller to be gone",
        )
        more_s = self.status()["plant"]["skipped_s"] - skipped_s
        if more_s > 0.0:
            raise LateError(f"the lab fell behind real time and skipped {more_s:.2f} s")
        time.sleep(max(0.0, gone + REST_S - time.monotonic()))

    def _topic(self, name: str) -> str:
        return f"/{NAMESPACE}/{name}"

    def _target_node(self, target: Target, stack: contextlib.ExitStack) -> Any:
        """The target's node, known to the graph; its time begins once it is spun."""
        from rclpy.parameter import Parameter

        from pneu_policy.nodes.target import TargetNode

        values = {
            "tap": self.tap,
            "kind": target.kind,
            "low_pa": target.low_pa,
            "high_pa": target.high_pa,
            "period_s": target.period_s,
            "turn_s": target.turn_s,
            "jitter": target.jitter,
            "seed": target.seed,
            "rate_hz": 1.0 / TARGET_STEP_S,
            "step_s": TARGET_STEP_S,
            "preview_s": PREVIEW_S,
        }
        node = TargetNode(
            context=self._context,
            namespace=NAMESPACE,
            use_global_arguments=False,
            parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
        )

        stack.callback(node.destroy_node)
        return node


@contextlib.contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """The environment of this process for as long as something is set up that reads it."""
    before = dict(os.environ)
    os.environ.update(values)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)
