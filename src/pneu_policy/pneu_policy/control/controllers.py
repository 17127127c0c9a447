# SPDX-License-Identifier: Apache-2.0
"""Controllers behind one interface: PID, with feed-forward, learned policies, predictive ones.

A controller is stepped once per period with the newest reading of each of its taps and the target
now and ahead, and answers with a voltage. It knows nothing of clocks, topics or plants.
"""

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from pneu_common.documents import read_yaml
from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_policy.control.controller import Controller as Controller
from pneu_policy.control.feed_forward import FeedForward
from pneu_policy.control.learned import PolicyController
from pneu_policy.control.pid import Gains, Pid
from pneu_policy.control.policy_file import PolicyFile

PERIOD_S = 0.004
"""Control period of a PID where none is named, s."""

VERSION = 1
KINDS = ("pid", "feed_forward", "predictive", "virtual")


class PidController:
    """A PID on the target of the present."""

    def __init__(
        self, gains: Gains, tap: str = "end", period_s: float = PERIOD_S, name: str = "pid"
    ) -> None:
        """Starts at rest.

        Args:
            gains: What it is set to.
            tap: Tap whose pressure it controls.
            period_s: Time from one step to the next, s.
            name: What to call it.

        Raises:
            InputError: The period is none.
        """
        if not (math.isfinite(period_s) and period_s > 0.0):
            raise InputError(f"period_s: found {period_s}, it must be positive")
        self.name, self.tap, self.period_s = name, tap, period_s
        self.taps: tuple[str, ...] = (tap,)
        self.tuned: Mapping[str, Any] = {}  # how its gains were found, where a file told
        self.preview_s: tuple[float, ...] = (0.0,)
        self._pid = Pid(gains)

    @property
    def gains(self) -> Gains:
        """What it is set to."""
        return self._pid.gains

    def reset(self) -> None:
        """Forgets the past."""
        self._pid.reset()

    def step(self, taps_pa: Mapping[str, float], targets_pa: Sequence[float]) -> float:
        """Voltage for the next period; see `Controller.step`.

        Args:
            taps_pa: Per tap its newest reading, Pa.
            targets_pa: Target now, Pa.
        """
        return self._pid.step(targets_pa[0], taps_pa[self.tap], self.period_s)


class FeedForwardPid(PidController):
    """A PID beside the voltage that the target's slope ahead asks for.

    The PID may take its target from a little ahead as well, because what it commands arrives late.
    """

    def __init__(
        self,
        gains: Gains,
        ahead: FeedForward,
        target_lead_s: float = 0.0,
        tap: str = "end",
        period_s: float = PERIOD_S,
        name: str = "feed_forward",
    ) -> None:
        """Starts at rest.

        Args:
            gains: What the PID is set to.
            ahead: The feed-forward.
            target_lead_s: How far ahead the PID takes its target, s.
            tap: Tap whose pressure it controls.
            period_s: Time from one step to the next, s.
            name: What to call it.

        Raises:
            InputError: A time is none.
        """
        super().__init__(gains, tap, period_s, name)
        if not (math.isfinite(target_lead_s) and target_lead_s >= 0.0):
            raise InputError(f"target_lead_s: found {target_lead_s}, it must be 0 or more")
        self.ahead = ahead
        self.target_lead_s = target_lead_s
        early, late = ahead.preview_s
        self.preview_s = tuple(sorted({0.0, target_lead_s, early, late}))
        self._early, self._late = map(self.preview_s.index, (early, late))
        self._target = self.preview_s.index(target_lead_s)

    def step(self, taps_pa: Mapping[str, float], targets_pa: Sequence[float]) -> float:
        """Voltage for the next period; see `Controller.step`.

        Args:
            taps_pa: Per tap its newest reading, Pa.
            targets_pa: Target at the times ahead, Pa.
        """
        early, late = targets_pa[self._early], targets_pa[self._late]
        if not (math.isfinite(early) and math.isfinite(late)):
            raise ValueError(f"found targets {early} Pa and {late} Pa ahead")
        more = self.ahead.volts(early, late)
        return self._pid.step(
            targets_pa[self._target], taps_pa[self.tap], self.period_s, more_v=more
        )


def load_controller(spec: str | Path) -> Controller:
    """Reads a controller from its file.

    Args:
        spec: A policy (.npz), a PID or feed-forward PID (.yaml) as `save_pid` writes it, or a
            predictive controller (.yaml), see `pneu_policy.control.predictive_file`; or another
            controller by virtual taps (.yaml), see `pneu_policy.control.virtual`.

    Returns:
        The controller, at rest.

    Raises:
        InputError: The file is missing, damaged, or holds no controller.
    """
    path = Path(spec)
    if path.suffix == ".npz":
        return PolicyController(PolicyFile.load(path))
    if path.suffix in (".yaml", ".yml"):
        return _load_yaml(path)
    raise InputError(f"{path}: a controller is a policy (.npz), a PID or a predictive one (.yaml)")


def save_pid(
    controller: PidController | FeedForwardPid, tuned: Mapping[str, Any], path: str | Path
) -> None:
    """Writes a PID, with or without feed-forward, whole or not at all.

    Args:
        controller: The controller.
        tuned: How its gains were found, plain data.
        path: Where; its folder must exist.

    Raises:
        InputError: It cannot be written.
    """
    forward = isinstance(controller, FeedForwardPid)
    data: dict[str, Any] = {
        "pneu_controller": VERSION,
        "kind": "feed_forward" if forward else "pid",
        "tap": controller.tap,
        "period_s": controller.period_s,
        "gains": dict(vars(controller.gains)),
    }
    if isinstance(controller, FeedForwardPid):
        data["target_lead_s"] = controller.target_lead_s
        data["feed_forward"] = controller.ahead.to_dict()
    data["tuned"] = dict(tuned)
    path = Path(path)
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 100
    text = io.StringIO()
    text.write("# SPDX-License-Identifier: Apache-2.0\n")
    yaml.dump(data, text)
    write_whole(path, text.getvalue())


def _load_yaml(path: Path) -> Controller:
    data = read_yaml(path, "file of a controller")
    if not isinstance(data, dict) or data.get("pneu_controller") != VERSION:
        found = data.get("pneu_controller") if isinstance(data, dict) else data
        raise InputError(f"{path}: pneu_controller: found {found!r}, this version reads {VERSION}")
    try:
        if data.get("kind") == "predictive":
            # here, because no other controller needs the solver
            from pneu_policy.control.predictive_file import predictive_of

            return predictive_of(data, path)
        if data.get("kind") == "virtual":
            return _virtual_of(data, path)
        controller = _pid_of(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    tuned = data.get("tuned", {})
    if not isinstance(tuned, dict):
        raise InputError(f"{path}: tuned: found {tuned!r}, needed is a mapping")
    controller.tuned = tuned
    return controller


def _virtual_of(data: Mapping[str, Any], path: Path) -> Controller:
    """A controller that sees virtual taps, by the files of it and of its rig."""
    from pneu_policy.control.followed import FollowedSettings
    from pneu_policy.control.virtual import VirtualTaps
    from pneu_sim.rig.load import load_rig

    settings = tuple(FollowedSettings.model_fields)
    known = ("pneu_controller", "kind", "controller", "rig", *settings)
    for name in data:
        if name not in known:
            raise InputError(f"{name}: unknown, known are {', '.join(known)}")
    files = []
    for name in ("controller", "rig"):
        file = data.get(name)
        if not isinstance(file, str):
            raise InputError(f"{name}: found {file!r}, needed is the path of a file")
        files.append(path.parent / file)
    taps = data.get("taps")
    if not (isinstance(taps, list) and taps and all(isinstance(tap, str) for tap in taps)):
        raise InputError(f"taps: found {taps!r}, needed are names of taps that are there")
    followed = FollowedSettings(**{name: data[name] for name in settings if name in data})
    inner = load_controller(files[0])
    return VirtualTaps(inner, load_rig(files[1]), followed, name=path.stem)


def _pid_of(data: Mapping[str, Any]) -> PidController | FeedForwardPid:
    kind = data.get("kind")
    if kind not in KINDS:
        raise InputError(f"kind: found {kind!r}, allowed are {', '.join(KINDS)}")
    known = ["pneu_controller", "kind", "tap", "period_s", "gains", "tuned"]
    if kind == "feed_forward":
        known += ["target_lead_s", "feed_forward"]
    for name in data:
        if name not in known:
            raise InputError(f"{name}: unknown, known are {', '.join(known)}")
    tap = data.get("tap", "end")
    if not isinstance(tap, str):
        raise InputError(f"tap: found {tap!r}, needed is the name of a tap")
    found = data.get("gains")
    if not isinstance(found, dict):
        raise InputError(f"gains: found {found!r}, needed is a mapping")
    allowed = [one.name for one in fields(Gains)]
    for name in found:
        if name not in allowed:
            raise InputError(f"gains.{name}: unknown, known are {', '.join(allowed)}")
    if "kp_v_per_pa" not in found:
        raise InputError("gains.kp_v_per_pa: missing")
    gains = {name: _number(value, f"gains.{name}") for name, value in found.items()}
    try:
        made = Gains(**gains)
    except InputError as error:
        raise InputError(f"gains.{error}") from None
    period_s = _number(data.get("period_s", PERIOD_S), "period_s")
    if kind == "pid":
        return PidController(made, tap, period_s)
    try:
        ahead = FeedForward.from_dict(data.get("feed_forward", {}))
    except InputError as error:
        raise InputError(f"feed_forward.{error}") from None
    lead_s = _number(data.get("target_lead_s", 0.0), "target_lead_s")
    return FeedForwardPid(made, ahead, lead_s, tap, period_s)


def _number(value: Any, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name}: found {value!r}, needed is a number")
    return float(value)
