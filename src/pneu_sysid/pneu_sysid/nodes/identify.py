# SPDX-License-Identifier: Apache-2.0
"""The identification node: fit, compare, diagnose and learn as an action, and a live watch.

Each goal runs in a process of its own, which a cancel ends for good. With the parameter
``watch_rig`` the node also runs that model alongside the incoming commands and readings, publishing
what it leaves unexplained. Parameters and topics: see ``ros_ws/README.md``.
"""

import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from pneu_msgs.action import Identify
from pneu_msgs.msg import EncoderResiduals, TapResiduals
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_graph.nodes.parameters import Parameters, parameter
from pneu_sim.rig import load_rig
from pneu_sim.rig.schema import Rig
from pneu_sysid.nodes.watching import Watching
from pneu_sysid.sensor_units import encoder_units
from pneu_sysid.tasks.process import TaskProcess
from pneu_sysid.tasks.request import Outcome, Request, check
from pneu_sysid.watch import ERROR_TIMES, WARN_TIMES, Verdict, Watch, Window

RESIDUALS_TOPIC = "taps/residuals"
ENCODER_RESIDUALS_TOPIC = "encoders/residuals"
LEVELS = {0: DiagnosticStatus.OK, 1: DiagnosticStatus.WARN, 2: DiagnosticStatus.ERROR}


@dataclass
class IdentifyParameters(Parameters):
    """What the identify node is told."""

    workers: int = parameter(0, "Threads of a task; 0 is all cores.", within=(0, 256))
    watch_rig: str = parameter(
        "", "Rig file of the model to run alongside; empty is none.", read_only=True
    )
    watch_rate_hz: float = parameter(
        250.0,
        "Rate at which model and taps are compared, not above that of the taps, Hz.",
        within=(10.0, 5000.0),
        read_only=True,
    )
    watch_window_s: float = parameter(
        0.0,
        "Length of a window, s; 0 is the horizon of the rig's fit.",
        within=(0.0, 10.0),
        read_only=True,
    )
    warn_times: float = parameter(
        WARN_TIMES,
        "Multiple of the expected error that is worth a warning.",
        within=(1.0, 1e6),
        read_only=True,
    )
    error_times: float = parameter(
        ERROR_TIMES,
        "Multiple of the expected error at which the model does not describe the rig.",
        within=(1.0, 1e6),
        read_only=True,
    )


class IdentifyNode(Node):
    """Identification on demand, and a running model's residual."""

    def __init__(self, **options: Any) -> None:
        """Offers the action and starts the watch where one is asked for.

        Args:
            options: Keywords of ``rclpy.node.Node``.

        Raises:
            InputError: A parameter or the watched rig file is wrong.
        """
        super().__init__("identify", **options)
        self._task: TaskProcess | None = None
        self._busy = False
        self._stage = ""
        self._watcher: Watcher | None = None
        try:
            self._set_up()
        except InputError:
            self.destroy_node()
            raise

    def _set_up(self) -> None:
        p = self._params = IdentifyParameters.declare(self)
        if p.watch_rig:
            rig = load_rig(p.watch_rig)
            watch = Watch(rig, p.watch_rate_hz, p.watch_window_s or None)
            self._watcher = Watcher(self, rig, watch, Verdict(p.warn_times, p.error_times))
        self._action = ActionServer(
            self,
            Identify,
            "~/identify",
            execute_callback=self._execute,
            goal_callback=self._on_goal,
            cancel_callback=self._on_cancel,
        )
        self._diagnostics = common.Diagnostics(self, self._report)
        if self._watcher is not None:
            self._watcher.start()

    def destroy_node(self) -> None:
        """Ends a running task and the watch, then the node."""
        if self._task is not None:
            self._task.end()
            self._task.wait()
        if self._watcher is not None:
            self._watcher.stop()
        super().destroy_node()

    def _on_goal(self, goal: Identify.Goal) -> GoalResponse:
        if self._busy:
            self.get_logger().warning("goal rejected: another one is being worked on")
            return GoalResponse.REJECT
        self._busy = True
        return GoalResponse.ACCEPT

    def _on_cancel(self, goal_handle: Any) -> CancelResponse:
        if self._task is not None:
            self._task.end()
        return CancelResponse.ACCEPT

    async def _execute(self, goal_handle: Any) -> Identify.Result:
        goal = goal_handle.request
        output = Path(goal.output)
        aside = output.absolute().parent / f".{output.name}.{uuid.uuid4().hex[:8]}.part"
        request = Request(
            goal.task,
            goal.bag,
            goal.rig,
            goal.output,
            str(aside),
            int(self._params.workers),
            tuple(goal.more_bags),
        )
        try:
            check(request)
        except InputError as error:
            self._busy = False
            goal_handle.abort()
            return Identify.Result(success=False, message=str(error))
        done = common.from_another_thread(self)

        def tell(stage: str, fraction: float) -> None:
            self._stage = stage
            if goal_handle.is_active:
                goal_handle.publish_feedback(Identify.Feedback(stage=stage, progress=fraction))

        self.get_logger().info(f"{goal.task} of {goal.bag}")
        self._task = TaskProcess(request, tell, done.set_result)
        if goal_handle.is_cancel_requested:  # between acceptance and start
            self._task.end()
        outcome: Outcome = await done
        self._task, self._busy, self._stage = None, False, ""
        if goal_handle.is_cancel_requested and not outcome.success:
            goal_handle.canceled()
        elif outcome.success:
            goal_handle.succeed()
        else:
            goal_handle.abort()
        if outcome.success:
            self.get_logger().info(f"{goal.task}: {outcome.verdict or 'done'}")
        else:
            self.get_logger().warning(f"{goal.task}: {outcome.message}")
        return Identify.Result(
            success=outcome.success,
            message=outcome.message,
            verdict=outcome.verdict,
            result_file=outcome.result_file,
        )

    def _report(self) -> list[DiagnosticStatus]:
        name = self.get_name()
        text = f"working: {self._stage or 'starting'}" if self._busy else "idle"
        lines = [common.status(DiagnosticStatus.OK, f"{name}: identification", text, {}, "")]
        if self._watcher is not None:
            lines.append(self._watcher.report())
        return lines


class Watcher:
    """Runs a model alongside the graph, and publishes and reports what it leaves."""

    def __init__(self, node: Node, rig: Rig, watch: Watch, verdict: Verdict) -> None:
        """Subscribes; `start` sets it going.

        Args:
            node: The node.
            rig: The model.
            watch: Compares it.
            verdict: Judges it.
        """
        self._node = node
        self._rig = rig
        self._publisher = node.create_publisher(TapResiduals, RESIDUALS_TOPIC, 10)
        self._units = encoder_units(rig)
        self._encoder_publisher: Any = None
        if rig.encoders:
            self._encoder_publisher = node.create_publisher(
                EncoderResiduals, ENCODER_RESIDUALS_TOPIC, 10
            )
        self._watching = Watching(node, rig, watch, verdict, self._publish)

    def start(self) -> None:
        """Starts the thread."""
        self._watching.start()

    def stop(self) -> None:
        """Ends the thread and waits for it."""
        self._watching.stop()

    def report(self) -> DiagnosticStatus:
        """How well the model describes the rig."""
        name = f"{self._node.get_name()}: model {self._rig.name}"
        watching = self._watching
        level, window = watching.verdict.level, watching.newest
        if watching.failure:
            return common.status(DiagnosticStatus.ERROR, name, watching.failure, {}, self._rig.name)
        if window is None or level < 0:
            text = "too few samples of sensors and commands to judge the model yet"
            return common.status(DiagnosticStatus.STALE, name, text, {}, self._rig.name)
        times = watching.verdict.times_expected
        text = f"as expected: {times:.2g} times the error known from its calibration"
        if level > 0:
            what = "worse than expected" if level == 1 else "the model does not describe the rig"
            text = f"{what}: {times:.2g} times the expected error, most at {window.worst}"
        values = {
            f"rms {name} ({self._units.get(name, 'Pa')})": float(rms)
            for name, rms in zip(window.sensors, window.rms, strict=True)
        }
        return common.status(LEVELS[level], name, text, values, self._rig.name)

    def _publish(self, window: Window) -> None:
        taps = len(self._rig.taps)
        self._send(
            self._publisher,
            window,
            TapResiduals(
                window_s=window.length_s,
                name=window.sensors[:taps],
                residual_pa=window.residual[:taps].tolist(),
                rms_pa=window.rms[:taps].tolist(),
                noise_floor_pa=window.noise[:taps].tolist(),
            ),
        )
        if self._encoder_publisher is not None:
            self._send(
                self._encoder_publisher,
                window,
                EncoderResiduals(
                    window_s=window.length_s,
                    name=window.sensors[taps:],
                    unit=[self._units[name] for name in window.sensors[taps:]],
                    residual=window.residual[taps:].tolist(),
                    rms=window.rms[taps:].tolist(),
                    noise_floor=window.noise[taps:].tolist(),
                ),
            )

    def _send(self, publisher: Any, window: Window, message: Any) -> None:
        message.header.stamp = common.to_stamp(round(window.end_s * 1e9))
        message.header.frame_id = self._rig.name
        publisher.publish(message)


def main(args: list[str] | None = None) -> None:
    """Runs the node.

    Args:
        args: Command line; None is the process's own.
    """
    common.run_node(IdentifyNode, args)


if __name__ == "__main__":
    main()
