# SPDX-License-Identifier: Apache-2.0
"""Two robots moved by their valves alone: a joint that swings, and a creature that rears up.

Run ``python examples/robots.py`` (ten seconds); it prints how far and how hard they move, and draws
docs/figures/robots.png, which needs matplotlib.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sim.rig import load_rig
from pneu_sim.simulator import Readings, Simulator

ROOT = Path(__file__).resolve().parents[1]
FIGURE = ROOT / "docs" / "figures" / "robots.png"
SAMPLE_S = 2e-3

Floats = NDArray[np.float64]


def swing() -> tuple[Readings, dict[str, Floats]]:
    """The joint of `rigs/kokoro.yaml` under steps of both valves against each other."""
    levels = np.repeat([5.0, 6.2, 5.0, 3.6, 5.0, 7.0], 125)
    volts = {"head": levels, "rod": 10.0 - levels}
    simulator = Simulator(load_rig(ROOT / "rigs" / "kokoro.yaml"))
    simulator.reset(dict.fromkeys(("head_tube", "rod_tube", "head", "rod"), 3.5e5))
    return simulator.run(SAMPLE_S * levels.size, volts, SAMPLE_S), volts


def rear() -> Readings:
    """The creature of `rigs/dog.yaml`: crouched on its air, then knees at once."""
    rig = load_rig(ROOT / "rigs" / "dog.yaml")
    simulator = Simulator(rig)
    charged = {name: 3.5e5 for name in (*rig.pipes, *simulator.plant.plan.chambers)}
    simulator.reset(charged)
    samples = 400
    time = SAMPLE_S * np.arange(samples)
    volts = {name: np.full(samples, 5.0) for name in rig.commands}
    for name in ("front_knee", "rear_knee"):
        volts[name] = np.where((time >= 0.3) & (time < 0.5), 10.0, 5.0)
    return simulator.run(SAMPLE_S * samples, volts, SAMPLE_S)


def dog_lines(q: Floats) -> list[Floats]:
    """Torso and legs of the creature as lines of (x, z) points, m.

    Args:
        q: (7,) its joints.
    """
    x, z, pitch = q[:3]
    lines = []
    hips = []
    for sign, hip, knee in ((1.0, q[3], q[4]), (-1.0, q[5], q[6])):
        at = np.array([x, z]) + sign * 0.2 * np.array([math.cos(pitch), math.sin(pitch)])
        a = pitch + hip
        b = a + knee
        elbow = at + 0.2 * np.array([math.sin(a), -math.cos(a)])
        foot = elbow + 0.2 * np.array([math.sin(b), -math.cos(b)])
        lines.append(np.array([at, elbow, foot]))
        hips.append(at)
    return [np.array(hips), *lines]


def joint_lines(theta: float) -> list[Floats]:
    """Link, crank and cylinder of the joint as lines of (x, z) points, m.

    Args:
        theta: Its angle, 0 upright.
    """
    tip = 0.2 * np.array([math.sin(theta), math.cos(theta)])
    pin = -0.035 * np.array([math.sin(theta + 0.5 * math.pi), math.cos(theta + 0.5 * math.pi)])
    pivot = np.array([0.0, -0.160])
    return [np.array([[0.0, 0.0], tip]), np.array([[0.0, 0.0], pin]), np.array([pivot, pin])]


def draw(moved: tuple[Readings, dict[str, Floats]], reared: Readings) -> None:
    """Draws poses of both, and what made the joint swing.

    Args:
        moved: The joint's readings and its commands.
        reared: The creature's readings.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    out, volts = moved
    figure = plt.figure(figsize=(10.0, 9.0), layout="constrained")
    grid = figure.add_gridspec(4, 1, height_ratios=(1.1, 1.5, 1.2, 0.8))
    _draw_dog(figure.add_subplot(grid[0]), reared)
    time = out.time_s
    angle = figure.add_subplot(grid[1])
    angle.plot(time, out.joints["elbow"], color="black")
    for k in range(0, time.size, 75):
        inset = angle.inset_axes(
            (time[k] - 0.07, out.joints["elbow"][k] - 0.45, 0.14, 0.9), transform=angle.transData
        )
        for line, colour in zip(
            joint_lines(float(out.joints["elbow"][k])),
            ("black", "tab:red", "tab:blue"),
            strict=True,
        ):
            inset.plot(*line.T, color=colour, linewidth=1.5)
        inset.set_xlim(-0.22, 0.22)
        inset.set_ylim(-0.2, 0.24)
        inset.set_aspect("equal")
        inset.axis("off")
    angle.set_ylabel("joint, rad")
    angle.set_ylim(-1.5, 1.5)
    angle.set_title("a joint swings: link, crank and cylinder on the curve of its angle")
    pressure = figure.add_subplot(grid[2], sharex=angle)
    for name, colour in (("head", "tab:blue"), ("rod", "tab:orange")):
        pressure.plot(
            time, out.pressures[f"{name}_valve"] / 1e5, color=colour, linewidth=0.8,
            label=f"{name}, at the valve",
        )  # fmt: skip
        pressure.plot(
            time, out.chambers[name] / 1e5, color=colour, linewidth=2.0, label=f"{name}, cylinder"
        )
    pressure.set_ylabel("pressure, bar absolute")
    pressure.set_ylim(0.5, 7.6)
    pressure.legend(ncols=4, fontsize=8, loc="upper right")
    command = figure.add_subplot(grid[3], sharex=angle)
    for name, colour in (("head", "tab:blue"), ("rod", "tab:orange")):
        command.step(time[:-1], volts[name], where="post", color=colour, label=name)
    command.set_ylabel("command, V")
    command.set_xlabel("time, s")
    command.legend(ncols=2, fontsize=8, loc="lower left")
    FIGURE.parent.mkdir(exist_ok=True)
    figure.savefig(FIGURE, dpi=110)


def _draw_dog(axes: Any, reared: Readings) -> None:
    """Poses of the creature, one beside the other."""
    q = np.array([reared.joints[name] for name in reared.joints]).T
    for n, k in enumerate(range(100, 400, 27)):
        pose = q[k].copy()
        pose[0] = 0.62 * n
        torso, *legs = dog_lines(pose)
        axes.plot(*torso.T, color="black", linewidth=5.0, solid_capstyle="round")
        for leg, colour in zip(legs, ("tab:blue", "tab:orange"), strict=True):
            axes.plot(*leg.T, color=colour, linewidth=2.5, marker="o", markersize=3)
        axes.annotate(f"{reared.time_s[k]:.2f} s", (pose[0], 0.62), ha="center", fontsize=8)
    axes.axhline(0.0, color="0.6")
    axes.set_aspect("equal")
    axes.set_ylim(-0.05, 0.72)
    axes.set_title("a creature stretches its knees: their valves open at 0.3 s")
    axes.axis("off")


def main() -> None:
    """Moves both, prints what they did and draws it."""
    moved = swing()
    out, _ = moved
    angle, speed = out.joints["elbow"], out.speeds["elbow"]
    print(
        f"joint: {angle.min():.2f} to {angle.max():.2f} rad, up to {np.abs(speed).max():.1f} rad/s,"
        f" forces of the gas {out.forces['forearm'].min():.0f} to"
        f" {out.forces['forearm'].max():.0f} N"
    )
    reared = rear()
    height = reared.joints["dog_z"]
    print(f"creature: its torso rises from {height[149]:.2f} to {height.max():.2f} m")
    draw(moved, reared)
    print(f"drawn: {FIGURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
