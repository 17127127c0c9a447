# SPDX-License-Identifier: Apache-2.0
"""Controllers of a robot's joints behind one interface (thesis 9.2).

- ``joint_pid``: the PID of eq. 9.2, each joint by the pair of valves of its cylinder.
- ``computed_torque``: the forces that a plan asks for (`pneu_policy.control.planner`), each made by
  a proportional and integral loop over the pressures.
- a learned policy, with the plan's forces before it where its recipe asks for them: with positions
  told, a hint (9.2.3); with forces alone, the hybrid (9.2.4).
- ``predictive``: plans on the rig's own model (`pneu_policy.control.predictive_joint`).

A controller is stepped once per period with the newest readings and the targets from now on, and
answers with voltages. It knows nothing of clocks, topics or plants.
"""

import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_policy.control.drive import Drive
from pneu_policy.control.joint import JointGains, JointPid
from pneu_policy.control.plan_settings import PlanSettings
from pneu_policy.control.planner import Planner
from pneu_policy.control.predictive_joint import PredictiveJoint
from pneu_policy.control.predictive_settings import JointPredictiveSettings
from pneu_policy.control.robot_policy import RobotPolicy
from pneu_policy.control.robot_recipe import Moment, RobotObserver
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

VERSION = 1
KINDS = ("joint_pid", "computed_torque", "predictive")
"""Those that come from a ``.yaml``."""


class RobotController(Protocol):
    """What controllers of robots have in common.

    Attributes:
        name: What to call it.
        tracked: Encoders that have targets.
        encoders: Encoders it must be told, the tracked ones among them.
        taps: Taps it must be told.
        commands: Commands it gives.
        period_s: Time from one step to the next, s.
        reach: Periods of targets it must be told, the present one first.
    """

    name: str
    tracked: tuple[str, ...]
    encoders: tuple[str, ...]
    taps: tuple[str, ...]
    commands: tuple[str, ...]
    period_s: float
    reach: int

    def reset(self) -> None:
        """Forgets the past."""

    def step(
        self, positions: Mapping[str, float], taps_pa: Mapping[str, float], targets: Floats
    ) -> dict[str, float]:
        """Voltages for the next period.

        Args:
            positions: By encoder its newest reading, rad or m.
            taps_pa: By tap likewise, Pa.
            targets: (tracked, reach) now and at the periods after, rad or m.

        Raises:
            ValueError: A number is not finite.
        """


class JointPidController:
    """The PID of eq. 9.2 on the targets of the present."""

    def __init__(
        self, drives: list[Drive], gains: list[JointGains], period_s: float, name: str = "joint_pid"
    ) -> None:
        """Starts at rest.

        Args:
            drives: The joints.
            gains: What each is controlled with.
            period_s: Time from one step to the next, s.
            name: What to call it.
        """
        self.name, self.drives, self.gains = name, drives, gains
        self.period_s, self.reach = period_s, 1
        self.tracked = self.encoders = tuple(drive.encoder for drive in drives)
        self.taps = tuple(tap for drive in drives for tap in drive.taps)
        self.commands = tuple(c for d in drives for c in (d.head_command, d.rod_command))
        self._pids = [JointPid(g) for g in gains]

    def reset(self) -> None:
        """Forgets the past."""
        for pid in self._pids:
            pid.reset()

    def step(
        self, positions: Mapping[str, float], taps_pa: Mapping[str, float], targets: Floats
    ) -> dict[str, float]:
        """Voltages for the next period; see `RobotController.step`.

        Args:
            positions: By encoder.
            taps_pa: By tap.
            targets: (tracked, 1).
        """
        volts: dict[str, float] = {}
        for k, (drive, pid) in enumerate(zip(self.drives, self._pids, strict=True)):
            force = drive.force_n(taps_pa)
            u = pid.step(float(targets[k, 0]), positions[drive.encoder], force, self.period_s)
            volts |= _pair(drive, u)
        return volts


@dataclass(frozen=True)
class TorqueGains:
    """What a loop over forces is set to.

    Attributes:
        kf_v_n: Volts per newton that is missing.
        ki_v_n_s: Volts per newton and second that is missing.
        integral_v: Limit of the integral term on either side, V.
        lead_s: How far ahead the force is taken from the plan, because commands arrive late, s.
        most_v: Limit on either side of the null, V.
    """

    kf_v_n: float
    ki_v_n_s: float = 0.0
    integral_v: float = 1.0
    lead_s: float = 0.02
    most_v: float = 5.0

    def __post_init__(self) -> None:
        """Raises InputError where the numbers make no controller."""
        for name, value in vars(self).items():
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"{name}: found {value:g}, it must be finite and not negative")


class ComputedTorque:
    """Forces from a plan, made by loops over the pressures."""

    def __init__(
        self,
        drives: list[Drive],
        gains: list[TorqueGains],
        plan: PlanSettings,
        rig: Rig,
        period_s: float,
        name: str = "computed_torque",
    ) -> None:
        """Reads the dynamics of the rig.

        Args:
            drives: The joints, all that move.
            gains: What the force of each is made with.
            plan: How joints are led to their targets.
            rig: The rig, as far as it is known.
            period_s: Time from one step to the next, s.
            name: What to call it.

        Raises:
            InputError: The rig has no inverse dynamics, or moves by other cylinders.
        """
        self.name, self.drives, self.gains = name, drives, gains
        self.period_s = period_s
        self.tracked = self.encoders = tuple(drive.encoder for drive in drives)
        self.taps = tuple(tap for drive in drives for tap in drive.taps)
        self.commands = tuple(c for d in drives for c in (d.head_command, d.rod_command))
        lead_s = max(max(g.lead_s for g in gains), period_s)
        self.planner = Planner(plan, rig, list(self.tracked), period_s, lead_s)
        self._order = [self.planner.cylinders.index(drive.cylinder) for drive in drives]
        self.reach = self.planner.reach
        self.reset()

    def reset(self) -> None:
        """Forgets the past."""
        self.planner.reset()
        self._integral_v = [0.0] * len(self.drives)

    def step(
        self, positions: Mapping[str, float], taps_pa: Mapping[str, float], targets: Floats
    ) -> dict[str, float]:
        """Voltages for the next period; see `RobotController.step`.

        Args:
            positions: By encoder.
            taps_pa: By tap.
            targets: (tracked, reach).
        """
        now = np.array([[positions[name] for name in self.encoders]])
        _check(now, targets)
        forces, _ = self.planner.plan(now, targets[None])
        volts: dict[str, float] = {}
        for k, (drive, g) in enumerate(zip(self.drives, self.gains, strict=True)):
            course = forces[0, self._order[k]]
            at = g.lead_s / self.period_s
            wanted = float(np.interp(at, np.arange(course.size), course))
            missing = wanted - drive.force_n(taps_pa)
            if not math.isfinite(missing):
                raise ValueError(f"found readings {dict(taps_pa)} Pa, all must be finite")
            more = self._integral_v[k] + g.ki_v_n_s * missing * self.period_s
            more = min(max(more, -g.integral_v), g.integral_v)
            u = g.kf_v_n * missing + more
            if abs(u) <= g.most_v or abs(more) < abs(self._integral_v[k]):
                self._integral_v[k] = more
            u = g.kf_v_n * missing + self._integral_v[k]
            volts |= _pair(drive, min(max(u, -g.most_v), g.most_v))
        return volts


class RobotPolicyController:
    """A learned policy, and the plan before it where its recipe asks for one."""

    def __init__(self, policy: RobotPolicy, rig: Rig) -> None:
        """Takes the policy.

        Args:
            policy: The policy.
            rig: The rig, as far as it is known.

        Raises:
            InputError: The policy was trained for another rig, or sees what no sensor tells.
        """
        policy.check_rig(rig)
        r = policy.recipe
        if not r.hardware:
            raise InputError(
                f"{policy.path or 'policy'}: sees spools or the gas of lines, which no sensor tells"
            )
        self.policy = policy
        self.name = policy.path.stem if policy.path is not None else "policy"
        self.tracked, self.taps, self.commands = r.tracked, r.taps, r.commands
        self.encoders = r.measured
        self.period_s = r.period_s
        self._observer = RobotObserver(r)
        self._previews = [round(at / r.period_s) for at in r.preview_s]
        self.reach = self._previews[-1] + 1
        self.planner: Planner | None = None
        if r.forces:
            self.planner = Planner.of_recipe(r, rig)
            self.reach = max(self.reach, self.planner.reach)
        self.reset()

    def reset(self) -> None:
        """Forgets the past."""
        self._observer.reset()
        if self.planner is not None:
            self.planner.reset()

    def step(
        self, positions: Mapping[str, float], taps_pa: Mapping[str, float], targets: Floats
    ) -> dict[str, float]:
        """Voltages for the next period; see `RobotController.step`.

        Args:
            positions: By encoder.
            taps_pa: By tap.
            targets: (tracked, reach).
        """
        r = self.policy.recipe
        told = r.positions(np.array([[positions[name] for name in self.encoders]]))
        _check(told, targets)
        forces = ways = None
        if self.planner is not None:
            at = [list(r.encoders).index(name) for name in r.tracked]
            forces, ways = self.planner.plan(told[:, at], targets[None, :, : self.planner.reach])
            forces, ways = forces[:, :, self._previews], ways[:, :, self._previews]
        now = Moment(
            positions=told,
            taps_pa=np.array([[taps_pa[tap] for tap in self.taps]]),
            targets=targets[None, :, self._previews],
            forces_n=forces,
            ways=ways,
        )
        action = self.policy.act(self._observer.observe(now)[0])[None]
        self._observer.acted(action)
        return dict(zip(self.commands, r.volts(action)[0].tolist(), strict=True))


def _pair(drive: Drive, u: float) -> dict[str, float]:
    """Voltages of both valves of a drive: one opens as far as the other closes."""
    return {drive.head_command: drive.null_v + u, drive.rod_command: drive.null_v - u}


def _check(positions: Floats, targets: Floats) -> None:
    if not (np.isfinite(positions).all() and np.isfinite(targets).all()):
        raise ValueError(f"found positions {positions} and targets {targets}, all must be finite")


def save_robot_controller(
    controller: JointPidController | ComputedTorque, path: str | Path, tuned: dict[str, Any]
) -> None:
    """Writes a controller that was tuned, whole or not at all.

    Args:
        controller: The controller.
        path: Where, a ``.yaml``; its folder must exist.
        tuned: How its gains were found, plain data.

    Raises:
        InputError: It cannot be written.
    """
    kind = "joint_pid" if isinstance(controller, JointPidController) else "computed_torque"
    document: dict[str, Any] = {
        "pneu_robot_controller": VERSION,
        "kind": kind,
        "period_s": controller.period_s,
        "drives": [
            {
                "encoder": drive.encoder,
                "cylinder": drive.cylinder,
                "taps": list(drive.taps),
                "gains": dict(vars(gains)),
            }
            for drive, gains in zip(controller.drives, controller.gains, strict=True)
        ],
    }
    if isinstance(controller, ComputedTorque):
        document["plan"] = controller.planner.settings.plain()
    document["tuned"] = tuned
    stream = io.StringIO()
    YAML(typ="safe", pure=True).dump(document, stream)
    write_whole(Path(path), stream.getvalue())


def load_robot_controller(path: str | Path, rig: Rig) -> RobotController:
    """Reads a controller for a rig.

    Args:
        path: A policy (``.npz``) or a tuned controller (``.yaml``).
        rig: The rig, as far as it is known.

    Raises:
        InputError: The file is missing or wrong, or not for this rig.
    """
    path = Path(path)
    if path.suffix == ".npz":
        return RobotPolicyController(RobotPolicy.load(path), rig)
    document = read_yaml(path, "controller")
    if not isinstance(document, dict) or document.get("pneu_robot_controller") != VERSION:
        found = document.get("pneu_robot_controller") if isinstance(document, dict) else None
        raise InputError(
            f"{path}: pneu_robot_controller: found {found!r}, this version reads {VERSION}"
        )
    try:
        return _from_document(document, rig, path.stem)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: is no controller of a robot ({error})") from None


def _from_document(document: dict[str, Any], rig: Rig, name: str) -> RobotController:
    kind, period_s = document["kind"], float(document["period_s"])
    if kind not in KINDS:
        raise InputError(f"kind: found {kind!r}, allowed are {', '.join(KINDS)}")
    if not (math.isfinite(period_s) and period_s > 0.0):
        raise InputError(f"period_s: found {period_s:g}, it must be positive")
    drives = []
    for given in document["drives"]:
        head, rod = given["taps"]
        drives.append(Drive.of_rig(rig, given["encoder"], given["cylinder"], (head, rod)))
    if kind == "predictive":
        return _predictive(document, drives, rig, name)
    gains = [given["gains"] for given in document["drives"]]
    if kind == "joint_pid":
        return JointPidController(drives, [_gains(JointGains, g) for g in gains], period_s, name)
    plan = PlanSettings(**document["plan"])
    loops = [_gains(TorqueGains, g) for g in gains]
    return ComputedTorque(drives, loops, plan, rig, period_s, name)


def _predictive(
    document: dict[str, Any], drives: list[Drive], rig: Rig, name: str
) -> PredictiveJoint:
    if len(drives) != 1:
        raise InputError(f"drives: found {len(drives)}, a predictive controller has one")
    try:
        settings = JointPredictiveSettings(
            **document.get("settings", {}), period_s=document["period_s"]
        )
    except InputError as error:
        raise InputError(f"settings.{error}") from None
    return PredictiveJoint(drives[0], rig, settings, name)


def _gains(of: Any, given: dict[str, Any]) -> Any:
    known = [field.name for field in fields(of)]
    for key in given:
        if key not in known:
            raise InputError(f"gains: found {key!r}, allowed are {', '.join(known)}")
    return of(**{key: float(value) for key, value in given.items()})
