# SPDX-License-Identifier: Apache-2.0
"""Contact force while an arm moves: the fixed-lag estimate, the raw sensor, a Kalman filter.

A plant whose truth is hidden is moved in its own time, so that figures are the same on a busy
machine. The estimate is made a hundred times a second from readings as they come, under parameters
that were identified from a recording before; whoever controls by it gets it one cycle later. Beside
it: what the sensor at the wrist says with the tip's weight taken out, and a Kalman filter of that
with force and its rate as states, which knows of no contact.
"""

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from scipy.optimize import minimize_scalar

from pneu_common.errors import InputError
from pneu_common.files import write_whole
from pneu_hw_bridge.hand_lab.hidden import open_truth
from pneu_sim.hand.drive import JointCommand, Motors
from pneu_sim.hand.exercise import exercise
from pneu_sim.hand.loading import Hand
from pneu_sim.hand.paths import Kinematics
from pneu_sim.hand.paths import Path as Path_
from pneu_sim.hand.press import Press, PressSettings
from pneu_sim.hand.truth import Truth
from pneu_sim.hand.world import Reading, World
from pneu_sim.hand.wrist import Wrist
from pneu_sysid.contacts.fit import fit_scene
from pneu_sysid.contacts.scene import Loaded, load_scene
from pneu_sysid.contacts.track import Series, Track, unbroken
from pneu_sysid.contacts.window import Window
from studies.digest import sources_digest

Floats = NDArray[np.float64]

ROOT = Path(__file__).resolve().parent.parent
ARM, TIP, THING = "phantom", "phantom_tip", "object"
SERVO_S = 0.0005
SOURCES = ("raw", "kalman", "estimate")
GAINS = (0.5, 1.0, 2.0, 4.0, 6.0)
"""How fast a tip is led on, m/s per N, of which each source gets its best."""
CYCLE_S = 0.01
"""From one estimate to the next, and until one is there to be used."""


@dataclass
class Run:
    """What a plant did and what was known of it, 1000 times a second.

    Attributes:
        time_s: When.
        true_n: (n, 3) force of the tip on the thing.
        raw_n: (n, 3) what the sensor says of it.
        track: What was read, as a recording.
        told: Of estimates: when it is of, what it says, when it was made, how long that took, s.
    """

    time_s: list[float] = field(default_factory=list)
    true_n: list[Floats] = field(default_factory=list)
    raw_n: list[Floats] = field(default_factory=list)
    track: Track | None = None
    told: list[tuple[float, Floats, float, float]] = field(default_factory=list)


class Feeder:
    """Gives a window what sensors of the plant read, and keeps it as a recording."""

    def __init__(self, loaded: Loaded, hand: Hand, knots: int) -> None:
        self.window = Window(loaded, loaded.scene.values, TIP, knots=knots)
        self._kept: dict[tuple[bool, str], list[tuple[float, Floats]]] = {}
        self._joints = hand.settings.arms[ARM].joints
        arm = hand.settings.arms[ARM].wrench
        assert arm is not None
        self._names = {
            "wrench": (arm.force, arm.torque),
            "imu": ("gyro", "accelerometer"),
            "pose": ("place", "turn"),
        }

    def joints(self, time_s: float, angles: list[float], torques: list[float]) -> None:
        for joint, angle, torque in zip(self._joints.values(), angles, torques, strict=True):
            self._sensor(joint.encoder, time_s, np.array([angle]))
            self.window.control(joint.motor, time_s, torque)
            self._kept.setdefault((True, joint.motor), []).append((time_s, np.array([torque])))

    def reading(self, reading: Reading) -> None:
        if reading.kind in self._names:
            first, second = self._names[reading.kind]
            self._sensor(first, reading.time_s, reading.values[:3])
            self._sensor(second, reading.time_s, reading.values[3:])

    def _sensor(self, name: str, time_s: float, values: Floats) -> None:
        self.window.sensor(name, time_s, values)
        self._kept.setdefault((False, name), []).append((time_s, values))

    def track(self) -> Track:
        """What was read, as a recording."""
        series = {
            key: Series(np.array([t for t, _ in kept]), np.array([v for _, v in kept]))
            for key, kept in self._kept.items()
        }
        sensors = {name: one for (driven, name), one in series.items() if not driven}
        turned = sensors["turn"]
        sensors["turn"] = Series(turned.time_s, unbroken(turned.values))
        return Track("recorded", sensors, {n: one for (driven, n), one in series.items() if driven})


def moved(
    hand: Hand,
    truth: Truth,
    loaded: Loaded,
    seconds: float,
    seed: int,
    go: Callable[[float, float, float], tuple[Floats, Floats | None]],
    source: str,
    knots: int = 16,
    changes: float = 100.0,
) -> Run:
    """Moves a plant.

    Args:
        hand: The hand.
        truth: What is hidden.
        loaded: The scene, with what was identified.
        seconds: How long.
        seed: Of the noise.
        go: Angles to go to and their velocities, by the time, the time since the last call, and the
            force along the line as `source` knows it.
        source: ``raw``, ``kalman`` or ``estimate``.
        knots: Of the estimate's window.
        changes: Of the filter.
    """
    world = World(hand, truth, seed, touch=True)
    joints = list(hand.settings.arms[ARM].joints.values())
    wrist, feeder, motors = Wrist(hand, ARM), Feeder(loaded, hand, knots), Motors(joints)
    kalman = Kalman(changes)
    run, torques, force, ready = Run(), [0.0] * len(joints), 0.0, []
    angles = [0.0] * len(joints)
    told: tuple[float, float, float] | None = None
    steps = round(seconds / world.step_s)
    every = round(SERVO_S / world.step_s)
    next_s = 0.2
    for number in range(steps):
        now = world.time_s
        if number % every == 0:
            wanted, speeds = go(now, SERVO_S, force)
            speeds = np.full(len(joints), np.nan) if speeds is None else speeds
            commands = [JointCommand(*both) for both in zip(wanted, speeds, strict=True)]
            torques = motors.drive(world.counts(ARM), now, commands)
            angles = motors.position_rad
            if number % (2 * every) == 0:
                feeder.joints(now, angles, torques)
        for reading in world.advance({ARM: torques}):
            feeder.reading(reading)
            if reading.kind == "wrench":
                push = wrist.push(np.array(angles), reading.values[:3])
                kalman.take(push, 1.0 / 1000.0)
                run.raw_n.append(push)
                if source == "raw":
                    force = float(push[0])
                elif source == "estimate" and told is not None:
                    # what the sensor has changed by since the instant that the estimate is of
                    force = told[1] + float(push[0]) - told[2]
                elif source == "kalman":
                    force = float(kalman.force_n[0])
            elif reading.kind == "touch":
                run.time_s.append(reading.time_s)
                run.true_n.append(reading.values[:3])
        if now >= next_s:
            begun = time.perf_counter()
            found = feeder.window.advance()
            took = time.perf_counter() - begun
            next_s += CYCLE_S
            if found is not None:
                run.told.append((found.time_s, found.touch[:3], now, took))
                then = run.raw_n[min(round(1000.0 * found.time_s), len(run.raw_n) - 1)]
                ready.append((now + CYCLE_S, float(found.touch[0]), float(then[0])))
        while ready and ready[0][0] <= now:
            told = ready.pop(0)
    run.track = feeder.track()
    return run


class Kalman:
    """A force that changes evenly but for noise, seen through noise; each component alone.

    Attributes:
        force_n: (3,).
    """

    READ_N = 0.01
    """Of the sensor."""

    def __init__(self, changes: float) -> None:
        """Knows nothing yet.

        Args:
            changes: Of the force's second derivative, N/s^2 per root of Hz; see `best_changes`.
        """
        self._changes = changes
        self._state = np.zeros((2, 3))
        self._spread = np.diag([1.0, 100.0])

    @property
    def force_n(self) -> Floats:
        return np.asarray(self._state[0])

    def take(self, push_n: Floats, step_s: float) -> None:
        """Takes a reading of the sensor."""
        moves = np.array([[1.0, step_s], [0.0, 1.0]])
        noise = self._changes**2 * np.array(
            [[step_s**3 / 3.0, step_s**2 / 2.0], [step_s**2 / 2.0, step_s]]
        )
        self._state = moves @ self._state
        self._spread = moves @ self._spread @ moves.T + noise
        gain = self._spread[:, 0] / (self._spread[0, 0] + self.READ_N**2)
        self._state = self._state + np.outer(gain, push_n - self._state[0])
        self._spread = self._spread - np.outer(gain, self._spread[0])


def filtered(raw: Floats, changes: float) -> Floats:
    """(n, 3) a recording of the sensor through the filter."""
    kalman, out = Kalman(changes), []
    for push in raw:
        kalman.take(push, 0.001)
        out.append(kalman.force_n.copy())
    return np.array(out)


def best_changes(run: Run) -> float:
    """How fast forces change, such that the filter is nearest the truth: its best."""
    raw, true = np.array(run.raw_n), np.array(run.true_n)
    count = min(len(raw), len(true))

    def off(log: float) -> float:
        return rmse(filtered(raw[:count], float(np.exp(log))) - true[:count])

    return float(np.exp(minimize_scalar(off, bounds=(0.0, 12.0), method="bounded").x))


def rmse(off: Floats) -> float:
    """Root of the mean square of all components."""
    return float(np.sqrt(np.mean(off**2)))


def identified(hand: Hand, truth: Truth, loaded: Loaded, seconds: float, seed: int) -> Loaded:
    """The scene with what is found of a recording of the plant."""
    kinematics = Kinematics(hand, ARM, TIP)
    path = exercise(hand, kinematics, TIP, THING, seconds, seed)
    run = moved(hand, truth, loaded, seconds, seed, followed(path), "raw")
    assert run.track is not None
    fit = fit_scene(loaded, [run.track])
    return Loaded(loaded.scene.with_values(fit.values), loaded.mjcf.parent)


def pressed(
    hand: Hand,
    truth: Truth,
    loaded: Loaded,
    seconds: float,
    seed: int,
    source: str,
    gain: float,
    changes: float,
) -> float:
    """How far the force is off that an arm presses with, N; infinite where it runs away."""
    kinematics = Kinematics(hand, ARM, TIP)
    press = Press(
        PressSettings(gain_m_s_n=gain, lead_m_n=0.0), kinematics, np.array([1.0, 0.0, 0.0])
    )

    def go(time_s: float, step_s: float, force_n: float) -> tuple[Floats, None]:
        return press.angles(time_s, step_s, force_n), None

    try:
        run = moved(hand, truth, loaded, seconds, seed, go, source, changes=changes)
    except InputError:  # the tip was led to where the arm cannot reach
        return float("inf")
    t, true = np.array(run.time_s), np.array(run.true_n)[:, 0]
    wanted = np.array([press.settings.wanted_n(x) for x in t])
    return rmse((true - wanted)[t > 2.0])


def followed(path: Path_) -> Callable[[float, float, float], tuple[Floats, Floats]]:
    """Goes along a path, whatever the force."""
    return lambda time_s, _step_s, _force_n: path.at(time_s)


def main(arguments: list[str] | None = None) -> int:
    """Runs the study; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hand", type=Path, default=ROOT / "scenes/phantom/hand.yaml")
    parser.add_argument("--scene", type=Path, default=ROOT / "scenes/phantom/hanging.yaml")
    parser.add_argument(
        "--truth", type=Path, default=ROOT / "scenes/phantom/hidden.json",
        help="what is hidden, sealed or plain",
    )  # fmt: skip
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--seeds", type=int, nargs="*", default=[11, 12, 13])
    parser.add_argument("--page", type=Path, help="file that receives the page")
    options = parser.parse_args(arguments)
    console = Console(width=140)
    hand, loaded = Hand(options.hand), load_scene(options.scene)
    truth = open_truth(options.truth)
    console.print("identifying")
    loaded = identified(hand, truth, loaded, 6.0, 1)
    found = ", ".join(f"{v.effect}@{v.at} {v.value:.4g}" for v in loaded.scene.values if v.value)
    console.print(found)
    kinematics = Kinematics(hand, ARM, TIP)

    rows = []
    changes = 0.0
    took: list[float] = []
    for seed in options.seeds:
        path = exercise(hand, kinematics, TIP, THING, options.seconds, seed)
        run = moved(hand, truth, loaded, options.seconds, seed, followed(path), "estimate")
        changes = changes or best_changes(run)
        t, true = np.array(run.time_s), np.array(run.true_n)
        when = np.array([told[0] for told in run.told])
        said = np.array([told[1] for told in run.told])
        lag = np.array([told[2] - told[0] for told in run.told])
        took += [told[3] for told in run.told]
        there = np.stack([np.interp(when, t, true[:, k]) for k in range(3)], axis=1)
        raw = np.array(run.raw_n)[: len(t)]
        smooth = filtered(raw, changes)
        pick = np.clip(np.searchsorted(t, when), 0, len(raw) - 1)
        rows.append(
            (
                seed, rmse(there), rmse(raw[pick] - there), rmse(smooth[pick] - there),
                rmse(said - there), 1e3 * float(np.median(lag)),
            )
        )  # fmt: skip
        console.print(rows[-1])
    lines = [
        "# Contact force while an arm moves", "", "Made by `make hand-force PAGE=file`.",
        f"Made from the sources {sources_digest()}.", "",
        f"What was identified from a recording of 6 s: {found}.", "",
        "| seed | true force, N, rms | raw sensor | Kalman filter | estimate | its lag, ms |",
        "|---|---|---|---|---|---|",
        *(
            f"| {s} | {a:.3f} | {b:.4f} | {c:.4f} | {d:.4f} | {e:.1f} |"
            for s, a, b, c, d, e in rows
        ),
        "",
        "RMSE against the hidden truth, N. The filter's one number,"
        f" {changes:.0f} N/s^2 per root of Hz, is the best for the first run, which only the truth"
        " tells.",
        "",
    ]  # fmt: skip
    best: dict[str, float] = {}
    tracked = []
    first, *others = options.seeds
    for source in SOURCES:
        by = {
            g: pressed(hand, truth, loaded, options.seconds, first, source, g, changes)
            for g in GAINS
        }
        best[source] = min(by, key=lambda g: by[g])
        console.print(source, by)
    for seed in others:
        offs = [
            pressed(hand, truth, loaded, options.seconds, seed, s, best[s], changes)
            for s in SOURCES
        ]
        tracked.append((seed, *offs))
        console.print(tracked[-1])
    gains = ", ".join(f"{best[s]:g} by the {s}" for s in SOURCES)
    lines += [
        "## Pressing with a force that is wanted",
        "",
        "0.35 N, swinging by 0.15 N at 0.5 Hz; RMSE after the first 2 s, N. Each has the gain that"
        f" was best for seed {first}, m/s per N: {gains}. An estimate is there to be used a cycle,"
        " 10 ms, after it was begun; what the sensor changed by since its instant is added.",
        "",
        "| seed | by the raw sensor | by the Kalman filter | by the estimate |",
        "|---|---|---|---|",
        *(f"| {s} | {a:.4f} | {b:.4f} | {c:.4f} |" for s, a, b, c in tracked),
        "",
    ]
    times = np.array(took)
    note = (
        f"a cycle took {1e3 * np.median(times):.1f} ms, p99"
        f" {1e3 * np.quantile(times, 0.99):.1f} ms, on this machine as busy as it was"
    )
    console.print("\n".join(lines), soft_wrap=True)
    console.print(note)
    if options.page is not None:
        write_whole(options.page, "\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
