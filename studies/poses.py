# SPDX-License-Identifier: Apache-2.0
"""Robots of links as pictures: a strip of poses, and a film.

What is drawn follows from the rig: lengths of links, where cranks are pinned, how far the rail
goes; and from where encoders were, control period by control period.
"""

import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pneu_common.files import whole
from pneu_sim.bodies.arm import Arm
from pneu_sim.bodies.cart_pole import CartPole
from pneu_sim.bodies.dog import Dog, Leg
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]
Line = tuple[Floats, dict[str, Any]]

FRAMES_HZ = 25.0
POSES = 9
"""Of a strip."""
THICK = {"color": "black", "linewidth": 4.0, "solid_capstyle": "round"}
THIN = {"color": "0.6", "linewidth": 1.0}
MASS = {"marker": "o", "markersize": 7.0}


def pose(rig: Rig, at: dict[str, float]) -> list[Line]:
    """Lines of a robot, each (points, 2) m with how it is drawn.

    Args:
        rig: The rig; it has one body.
        at: Positions by joint.

    Raises:
        TypeError: Nobody has said how this body is drawn.
    """
    body = next(iter(rig.bodies.values()))
    if isinstance(body, CartPole):
        return _cart_pole(rig, body, at)
    if isinstance(body, Arm):
        return _arm(body, at)
    if isinstance(body, Dog):
        return _dog(body, at)
    raise TypeError(f"no pose of a body of kind {body.kind!r}")


def _cart_pole(rig: Rig, body: CartPole, at: dict[str, float]) -> list[Line]:
    x, angle = at["cart"], at["pole"]
    stroke = rig.cylinders[body.cylinder].stroke
    low, high = body.closed_at_m, body.closed_at_m + stroke
    half = 0.06 * stroke
    tip = np.array([x, 0.0]) + body.rod.length_m * np.array([math.sin(angle), math.cos(angle)])
    cart = np.array([[x - half, 0.0], [x + half, 0.0]])
    rod = {"color": "tab:blue", "linewidth": 2.5, "markevery": [1]}
    return [
        (np.array([[low - half, 0.0], [high + half, 0.0]]), THIN),
        (cart, {"color": "black", "linewidth": 9.0, "solid_capstyle": "butt"}),
        (np.array([[x, 0.0], tip]), rod | MASS),
    ]  # fmt: skip


def _turned(point: tuple[float, float], angle: float) -> Floats:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * point[0] - s * point[1], s * point[0] + c * point[1]])


def _arm(body: Arm, at: dict[str, float]) -> list[Line]:
    a = at["shoulder"]
    b = a + at["elbow"]
    elbow = body.upper_arm.length_m * np.array([math.cos(a), math.sin(a)])
    hand = elbow + body.forearm.length_m * np.array([math.cos(b), math.sin(b)])
    first, second = body.shoulder_crank, body.elbow_crank
    cylinder = {"color": "tab:orange", "linewidth": 3.0}
    pins = [_turned(second.pivot_m, a), _turned(second.pin_m, b)]
    return [
        (np.array([first.pivot_m, _turned(first.pin_m, a)]), cylinder),
        (elbow + np.array(pins), cylinder),
        (np.array([[0.0, 0.0], elbow, hand]), THICK | MASS),
    ]  # fmt: skip


def _dog(body: Dog, at: dict[str, float]) -> list[Line]:
    name = next(n for n in at if n.endswith("_pitch")).removesuffix("pitch")
    middle, pitch = np.array([at[f"{name}x"], at[f"{name}z"]]), at[f"{name}pitch"]
    along = 0.5 * body.torso_length_m * np.array([math.cos(pitch), math.sin(pitch)])
    lines: list[Line] = []
    for sign, side, colour in ((-1.0, "rear", "tab:orange"), (1.0, "front", "tab:blue")):
        leg: Leg = getattr(body, side)
        hip = middle + sign * along
        a = pitch + at[f"{name}{side}_hip"]
        b = a + at[f"{name}{side}_knee"]
        knee = hip + leg.thigh.length_m * np.array([math.sin(a), -math.cos(a)])
        foot = knee + leg.shank.length_m * np.array([math.sin(b), -math.cos(b)])
        style = {"color": colour, "linewidth": 3.0, "marker": "o", "markersize": 4.0}
        lines.append((np.array([hip, knee, foot]), style))
    return [*lines, (np.array([middle - along, middle + along]), THICK | {"linewidth": 7.0})]


def _at(rig: Rig, told: dict[str, Any], k: int) -> tuple[dict[str, float], list[float]]:
    """Positions by joint in a control period, and targets."""
    place, target = told["path"][k]
    named = dict(zip(told["encoders"], place, strict=True))
    return {rig.encoders[n].on(n): x for n, x in named.items() if n in rig.encoders}, target


def _target(rig: Rig, target: list[float]) -> Floats | None:
    """Where a target is, (2,) m."""
    body = next(iter(rig.bodies.values()))
    if len(target) == 1 and isinstance(body, CartPole):
        return np.array([target[0], 0.0])
    return np.array(target) if len(target) == 2 else None


def _bounds(rig: Rig, told: dict[str, Any]) -> tuple[Floats, Floats]:
    """Lowest and highest corner of all poses, m."""
    points = np.concatenate(
        [line for k in range(len(told["path"])) for line, _ in pose(rig, _at(rig, told, k)[0])]
    )
    return points.min(axis=0) - 0.05, points.max(axis=0) + 0.05


def _put(axes: Axes, rig: Rig, told: dict[str, Any], k: int) -> None:
    at, target = _at(rig, told, k)
    goal = _target(rig, target)
    if goal is not None:
        axes.plot(*goal, "+", color="tab:red", markersize=12.0, markeredgewidth=2.0)
    for points, style in pose(rig, at):
        axes.plot(*points.T, **style)


def draw_strip(rig: Rig, told: dict[str, Any], path: Path) -> None:
    """Poses of an episode side by side; what walks, along the ground where it is.

    Args:
        rig: The rig.
        told: ``path`` of positions and targets, and names of ``encoders``.
        path: Picture.
    """
    low, high = _bounds(rig, told)
    body = next(iter(rig.bodies.values()))
    steps = np.linspace(0, len(told["path"]) - 1, POSES).round().astype(int)
    if isinstance(body, Dog):
        wide = high[0] - low[0]
        figure = Figure(figsize=(11.0, max(1.6, 11.0 * 0.75 / wide)), layout="constrained")
        panels = np.array([figure.add_subplot()] * POSES)
        panels[0].axhline(0.0, color="0.6")
    else:
        figure = Figure(figsize=(11.0, 2.4), layout="constrained")
        panels = figure.subplots(1, POSES, sharex=True, sharey=True)
    for axes, k in zip(panels, steps, strict=True):
        _put(axes, rig, told, int(k))
        axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.axis("off")
    with whole(path) as aside:
        figure.savefig(aside, format="png", dpi=110)


def film(rig: Rig, told: dict[str, Any], period_s: float, path: Path) -> None:
    """An episode as a film, at the speed of life.

    Args:
        rig: The rig.
        told: ``path`` of positions and targets, and names of ``encoders``.
        period_s: Control period, s.
        path: GIF.
    """
    low, high = _bounds(rig, told)
    size = 5.0 * (high - low) / max(high - low)
    figure = Figure(figsize=tuple(np.maximum(size, 1.5)), layout="constrained")
    axes = figure.add_subplot()
    every = max(1, round(1.0 / (FRAMES_HZ * period_s)))

    def frame(k: int) -> list[Any]:
        axes.clear()
        axes.axis("off")
        if isinstance(next(iter(rig.bodies.values())), Dog):
            axes.axhline(0.0, color="0.6")
        _put(axes, rig, told, k)
        axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        return []

    moving = FuncAnimation(figure, frame, frames=range(0, len(told["path"]), every))
    # Pillow goes by the name's ending, which a file that is written aside does not have
    with tempfile.TemporaryDirectory() as folder, whole(path) as aside:
        made = Path(folder) / "film.gif"
        moving.save(made, writer=PillowWriter(fps=round(1.0 / (every * period_s))), dpi=60)
        aside.write_bytes(made.read_bytes())
