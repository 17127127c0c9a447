# SPDX-License-Identifier: Apache-2.0
"""A recording as a chain of knots: residuals of forces and sensors, and what they change by.

Velocities are differences to the knot before and accelerations differences of those (thesis 2.3);
for even steps that is MuJoCo's semi-implicit Euler, so that a roll-out with the same step leaves
no residual. Where steps differ, an acceleration belongs to the mean of its two.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim.mechanism.loading import mujoco_module
from pneu_sysid.contacts.arrow import Arrow
from pneu_sysid.contacts.effects.base import Reading, Setup
from pneu_sysid.contacts.manifold import (
    Manifold,
    conjugate,
    logarithm,
    manifold_of,
    product,
    turned_by,
)
from pneu_sysid.contacts.norms import Norm
from pneu_sysid.contacts.physics import Motion, Physics
from pneu_sysid.contacts.scene import Loaded
from pneu_sysid.contacts.track import Series, Track

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

POSITION, VELOCITY = 1, 2
"""MuJoCo's stages that sensors need; what needs more depends on accelerations."""


@dataclass(frozen=True)
class Channel:
    """A sensor along a chain.

    Attributes:
        name: Its name in the MJCF.
        address: Where it begins in ``sensordata``.
        width: How many numbers it has.
        turns: Whether they are a quaternion: its residual is then a rotation vector.
        stage: What it needs.
        norm: How its residuals are weighed.
        series: Its readings.
        fast: Whether it tells more often than there are knots.
        knots: (m,) knots that have a reading.
    """

    name: str
    address: int
    width: int
    turns: bool
    stage: int
    norm: Norm
    series: Series
    fast: bool
    knots: Ints

    @property
    def size(self) -> int:
        """Components of its residual."""
        return 3 if self.turns else self.width


@dataclass(frozen=True)
class Outputs:
    """What a model says along a chain.

    Attributes:
        force: (n, nv) forces that nobody applied; of the first and the last knot they mean nothing.
        sensors: (n, ns) sensor data.
        motion: What they are of.
    """

    force: Floats
    sensors: Floats
    motion: Motion


@dataclass(frozen=True)
class Chain:
    """A recording's knots and readings.

    Attributes:
        name: Name of the recording.
        time_s: (n,) of the knots.
        channels: The sensors.
        control: (n, nu).
        manifold: Of its configurations.
        dof_norms: Of the force at each direction, (nv,).
        free: (F, 3) where free joints' translations stand in velocities.
        start: (n, nq) configurations as sensors alone tell them.
        slack: (n, nv) how much wider forces' standard deviations are than their norms say.
    """

    name: str
    time_s: Floats
    channels: tuple[Channel, ...]
    control: Floats
    manifold: Manifold
    dof_norms: tuple[Norm, ...]
    free: Ints
    start: Floats
    slack: Floats

    @property
    def size(self) -> int:
        """How many knots there are."""
        return len(self.time_s)

    def motion(self, q: Floats, setup: Setup) -> Motion:
        """Velocities and accelerations of a trajectory.

        Args:
            q: (n, nq).
            setup: The scene.
        """
        h = np.diff(self.time_s) * setup.clock
        v = np.empty((self.size, self.manifold.nv))
        v[1:] = self.manifold.between(q[:-1], q[1:]) / h[:, None]
        v[0] = v[1]
        a = np.zeros_like(v)
        a[1:-1] = (v[2:] - v[1:-1]) / (0.5 * (h[1:] + h[:-1]))[:, None]
        a[0], a[-1] = a[1], a[-2]
        return Motion(q, v, a, self.control, np.zeros_like(v))

    def outputs(self, q: Floats, model: Any, setup: Setup, physics: Physics) -> Outputs:
        """What a model says along a trajectory.

        Args:
            q: (n, nq).
            model: The model.
            setup: The scene it is made from.
            physics: What evaluates it.
        """
        motion = self.motion(q, setup)
        force, sensors = physics.evaluate(model, motion)
        return Outputs(force, sensors, motion)

    def forces(self, outputs: Outputs, setup: Setup) -> Floats:
        """(n, nv) residuals of forces.

        Args:
            outputs: What the model says.
            setup: The scene.
        """
        if setup.drag == 0.0:
            return outputs.force
        force = outputs.force.copy()
        for at in self.free:
            force[:, at] += setup.drag * outputs.motion.v[:, at]
        return force

    def misreadings(self, channel: Channel, outputs: Outputs, setup: Setup) -> Floats:
        """(m, size) residuals of a sensor: what it should read less what it read.

        Args:
            channel: The sensor.
            outputs: What the model says.
            setup: The scene.
        """
        told = setup.readings[channel.name]
        at = slice(channel.address, channel.address + channel.width)
        read = self.measured(channel, told)
        should = outputs.sensors[channel.knots, at]
        if channel.turns:
            return logarithm(product(conjugate(read), should))
        should = told.gain * should
        for component, bias in told.bias.items():
            should[:, component] += bias
        return np.asarray(should - read)

    def measured(self, channel: Channel, told: Reading) -> Floats:
        """(m, width) readings of a sensor at its knots, of a lag later.

        Args:
            channel: The sensor.
            told: How it tells.
        """
        times = self.time_s[channel.knots] + told.lag_s
        if not channel.fast:
            return channel.series.at(times, channel.turns)
        edges = np.concatenate(
            [self.time_s[:1], 0.5 * (self.time_s[1:] + self.time_s[:-1]), self.time_s[-1:]]
        )
        low, high = edges[channel.knots] + told.lag_s, edges[channel.knots + 1] + told.lag_s
        mean, any_there = channel.series.mean_over(low, high)
        return np.where(any_there[:, None], mean, channel.series.at(times))

    def rows(self, outputs: Outputs, setup: Setup) -> tuple[Floats, Floats]:
        """All residuals of a chain, a knot a row; NaN where there is none.

        Args:
            outputs: What the model says.
            setup: The scene.

        Returns:
            (n, nv) of forces, and (n, R) of sensors, one after another.
        """
        force = self.forces(outputs, setup) / self.slack
        force[0] = force[-1] = np.nan
        read = np.full((self.size, sum(c.size for c in self.channels)), np.nan)
        at = 0
        for channel in self.channels:
            misread = self.misreadings(channel, outputs, setup)
            read[channel.knots, at : at + channel.size] = misread
            at += channel.size
        return force, read

    def norms(self) -> list[Norm]:
        """The norm of each column of `rows`, forces first."""
        return [*self.dof_norms, *(c.norm for c in self.channels for _ in range(c.size))]

    def sensor_sigma(self) -> Floats:
        """(R,) standard deviation that each sensor component's norm stands for."""
        return np.array(
            [1.0 / np.sqrt(2.0 * c.norm.weight) for c in self.channels for _ in range(c.size)]
        )

    def cost(self, outputs: Outputs, setup: Setup) -> float:
        """Sum of all norms.

        Args:
            outputs: What the model says.
            setup: The scene.
        """
        rows = np.concatenate(self.rows(outputs, setup), axis=1)
        total = 0.0
        for k, norm in enumerate(self.norms()):
            column = rows[:, k]
            total += float(np.sum(norm.cost(column[np.isfinite(column)])))
        return total

    def arrow(
        self,
        q: Floats,
        outputs: Outputs,
        model: Any,
        setup: Setup,
        columns: list[tuple[Floats, Floats]],
        physics: Physics,
        centred: bool = True,
    ) -> Arrow:
        """Gradient and Gauss-Newton Hessian of the cost.

        Args:
            q: (n, nq).
            outputs: What the model says there.
            model: The model.
            setup: The scene.
            columns: What `rows` change by with each parameter.
            physics: What evaluates the model.
            centred: See `Physics.slopes`.
        """
        n, k = self.size, self.manifold.nv
        rows = np.concatenate(self.rows(outputs, setup), axis=1)
        there = np.isfinite(rows)
        r = np.where(there, rows, 0.0)
        norms = self.norms()
        bend = np.stack([norm.curvature(r[:, i]) for i, norm in enumerate(norms)], axis=1) * there
        slope = np.stack([norm.slope(r[:, i]) for i, norm in enumerate(norms)], axis=1) * there
        J = self._jacobian(outputs, model, setup, physics, centred)
        J *= there[:, :, None]
        P = np.zeros((n, len(norms), len(columns)))
        for c, change in enumerate(columns):
            P[:, :, c] = np.nan_to_num(np.concatenate(change, axis=1)) * there
        weighed = J * bend[:, :, None]
        M = np.swapaxes(weighed, 1, 2) @ J
        G = np.einsum("nok,no->nk", J, slope)
        S = np.swapaxes(weighed, 1, 2) @ P
        diagonal = M[:, k : 2 * k, k : 2 * k].copy()
        diagonal[:-1] += M[1:, :k, :k]
        diagonal[1:] += M[:-1, 2 * k :, 2 * k :]
        after_one = M[1:, k : 2 * k, :k] + M[:-1, 2 * k :, k : 2 * k]
        after_two = M[1:-1, 2 * k :, :k].copy()
        gradient = G[:, k : 2 * k].copy()
        gradient[:-1] += G[1:, :k]
        gradient[1:] += G[:-1, 2 * k :]
        shaft = S[:, k : 2 * k].copy()
        shaft[:-1] += S[1:, :k]
        shaft[1:] += S[:-1, 2 * k :]
        flat = P.reshape(n * len(norms), len(columns))
        return Arrow(
            diagonal=diagonal,
            next=after_one,
            after=after_two,
            shaft=shaft,
            tip=flat.T @ (flat * bend.reshape(-1, 1)),
            slope=gradient,
            tip_slope=flat.T @ slope.ravel(),
            cost=float(sum(np.sum(norm.cost(r[:, i])) for i, norm in enumerate(norms))),
        )

    def _jacobian(
        self, outputs: Outputs, model: Any, setup: Setup, physics: Physics, centred: bool
    ) -> Floats:
        """(n, outputs, 3 nv): of each knot's residuals by the knot before, itself and the next."""
        n, k = self.size, self.manifold.nv
        motion = outputs.motion
        h = np.diff(self.time_s) * setup.clock
        start, end = self.manifold.between_by(motion.v[1:] * h[:, None])
        start /= h[:, None, None]
        end /= h[:, None, None]
        by_v = np.zeros((n, k, 3 * k))
        by_v[1:, :, :k] = start
        by_v[1:, :, k : 2 * k] = end
        by_a = np.zeros((n, k, 3 * k))
        mean = 0.5 * (h[1:] + h[:-1])[:, None, None]
        by_a[1:-1, :, :k] = -start[:-1] / mean
        by_a[1:-1, :, k : 2 * k] = (start[1:] - end[:-1]) / mean
        by_a[1:-1, :, 2 * k :] = end[1:] / mean
        slopes = physics.slopes(model, motion, centred)
        force = slopes.force
        if setup.drag:
            for at in self.free:
                force[1][:, at, at] += setup.drag

        def chained(by: Floats) -> Floats:
            by = np.swapaxes(by, 2, 3)  # outputs first
            J = by[1] @ by_v + by[2] @ by_a
            J[:, :, k : 2 * k] += by[0]
            return np.asarray(J)

        parts = [chained(force) / self.slack[:, :, None]]
        for channel in self.channels:
            at = slice(channel.address, channel.address + channel.width)
            J = chained(slopes.sensors[:, :, :, at])
            told = setup.readings[channel.name]
            if channel.turns:
                turned = np.zeros((n, 3, 3 * k))
                where = channel.knots
                should = outputs.sensors[where, at]
                misread = self.misreadings(channel, outputs, setup)
                # the turn in the body's frame that a change of the quaternion is
                turn = _turn_of(should)
                turned[where] = turned_by(misread) @ (turn @ J[where])
                J = turned
            else:
                J *= told.gain
            parts.append(J)
        return np.concatenate(parts, axis=1)


def _turn_of(q: Floats) -> Floats:
    """(m, 3, 4): rotation vector, in the turned frame, per change of quaternions."""
    w, x, y, z = (q[:, i] for i in range(4))
    rows = [
        np.stack([-x, w, z, -y], axis=1),
        np.stack([-y, -z, w, x], axis=1),
        np.stack([-z, y, -x, w], axis=1),
    ]
    return 2.0 * np.stack(rows, axis=1)


def chain_of(loaded: Loaded, track: Track, model: Any, step_s: float | None = None) -> Chain:
    """Lays knots along a recording.

    Args:
        loaded: The scene.
        track: The recording.
        model: The model that says where bodies are near each other.
        step_s: Instead of the scene's steps, this one throughout.

    Raises:
        InputError: The recording is too short.
    """
    scene = loaded.scene
    begin, end = track.span_s
    names = [name for name in loaded.names if name in track.sensors]
    poses = [
        track.sensors[name]
        for name in names
        if int(model.sensor_needstage[model.sensor(name).id]) == POSITION
    ]
    knots = scene.knots
    coarse = step_s or knots.step_s
    slow = max(poses, key=lambda s: s.every_s, default=None)
    if slow is not None and slow.every_s >= 0.6 * coarse:
        marks = slow.time_s[(slow.time_s >= begin - 1e-9) & (slow.time_s <= end + 1e-9)]
    else:
        marks = np.linspace(begin, end, max(2, round((end - begin) / coarse) + 1))
    if len(marks) < 4:
        raise InputError(f"{track.name}: {end - begin:.3g} s with {len(marks)} readings: too short")
    fine = knots.contact_step_s if step_s is None else None
    near = np.zeros(len(marks) - 1, dtype=bool)
    if fine is not None:
        near = _near(model, guess(loaded, track, marks, model), knots.near_m)
    time: list[float] = []
    for k, (a, b) in enumerate(pairwise(marks)):
        step = fine if fine is not None and near[k] else coarse
        parts = max(1, int(np.ceil((b - a) / step - 1e-6)))
        time += list(a + (b - a) * np.arange(parts) / parts)
    t = np.array([*time, marks[-1]])
    return Chain(
        track.name,
        t,
        tuple(_channel(loaded, track, model, t, name) for name in names),
        _control(track, model, t),
        manifold_of(model),
        _dof_norms(loaded, model),
        _free(model),
        guess(loaded, track, t, model),
        np.ones((len(t), int(model.nv))),
    )


def with_slack(
    chain: Chain, loaded: Loaded, q: Floats, model: Any, setup: Setup, physics: Physics
) -> Chain:
    """A chain whose forces count less where bodies touch, by the scene's ``of_contact``.

    No model of contacts has their forces to a percent; weighed like those of free flight, what it
    gets wrong would drown everything else.

    Args:
        chain: The chain.
        loaded: The scene.
        q: (n, nq) a trajectory.
        model: The model.
        setup: The scene it is made from.
        physics: What evaluates it.
    """
    share = np.zeros(chain.manifold.nv)
    sigma = np.array([1.0 / np.sqrt(2.0 * norm.weight) for norm in chain.dof_norms])
    for j in range(model.njnt):
        first = int(model.jnt_dofadr[j])
        wide = {0: 6, 1: 3}.get(int(model.jnt_type[j]), 1)
        share[first : first + wide] = loaded.scene.forces[model.joint(j).name].of_contact
    if not np.any(share):
        return chain
    force = np.abs(physics.contact_forces(model, chain.motion(q, setup)))
    # all components of a contact are wrong together, and a knot too early or too late
    most = np.zeros_like(force)
    groups: dict[tuple[float, bytes], list[int]] = {}
    for k in range(chain.manifold.nv):
        groups.setdefault((float(share[k]), sigma[k].tobytes()), []).append(k)
    for at in groups.values():
        size = np.linalg.norm(force[:, at], axis=1)
        size = np.max(np.stack([np.roll(size, s) for s in (-2, -1, 0, 1, 2)]), axis=0)
        most[:, at] = size[:, None]
    return replace(chain, slack=np.sqrt(1.0 + (share * most / sigma) ** 2))


def _channel(loaded: Loaded, track: Track, model: Any, t: Floats, name: str) -> Channel:
    sensor = int(model.sensor(name).id)
    series = track.sensors[name]
    stage = int(model.sensor_needstage[sensor])
    width = int(model.sensor_dim[sensor])
    # the first knot has no velocity, the last no acceleration
    first, last = (0, len(t) - 1) if stage == POSITION else (1, len(t) - 1)
    if stage > VELOCITY:
        last = len(t) - 2
    every = float(np.median(np.diff(t)))
    fast = series.every_s < 0.75 * every
    if fast:
        knots = np.arange(first, last + 1)
        inside = (t[knots] >= series.time_s[0]) & (t[knots] <= series.time_s[-1])
        knots = knots[inside]
    else:
        nearest = np.clip(np.searchsorted(t, series.time_s), 1, len(t) - 1)
        nearer = series.time_s - t[nearest - 1] < t[nearest] - series.time_s
        nearest = nearest - nearer
        inside = np.abs(t[nearest] - series.time_s) <= 0.51 * np.max(np.diff(t))
        knots = np.unique(nearest[inside])
        knots = knots[(knots >= first) & (knots <= last)]
    return Channel(
        name,
        int(model.sensor_adr[sensor]),
        width,
        int(model.sensor_datatype[sensor]) == 3,  # mjDATATYPE_QUATERNION
        stage,
        loaded.scene.sensors[name].norm.norm(),
        series,
        fast,
        knots,
    )


def _control(track: Track, model: Any, t: Floats) -> Floats:
    out = np.zeros((len(t), int(model.nu)))
    for name, series in track.controls.items():
        out[:, model.actuator(name).id] = series.at(t)[:, 0]
    return out


def _dof_norms(loaded: Loaded, model: Any) -> tuple[Norm, ...]:
    out: list[Norm] = []
    for j in range(model.njnt):
        name = model.joint(j).name
        force = loaded.scene.forces[name]
        kind = int(model.jnt_type[j])
        wanted = {0: ("translation", "rotation"), 1: ("rotation",)}.get(kind, ("along",))
        for part in wanted:
            settings = getattr(force, part)
            if settings is None:
                raise InputError(f"forces: {name}: {part} is needed for a joint of its type")
            out += [settings.norm()] * (1 if part == "along" else 3)
    return tuple(out)


def _free(model: Any) -> Ints:
    at = [int(model.jnt_dofadr[j]) for j in range(model.njnt) if int(model.jnt_type[j]) == 0]
    return np.array([range(k, k + 3) for k in at], dtype=np.int64).reshape(-1, 3)


def guess(loaded: Loaded, track: Track, t: Floats, model: Any) -> Floats:
    """(n, nq) configurations as sensors of position alone tell them; the MJCF's where none does.

    Joints are where their encoders say, bodies that move freely where a frame on them is seen.

    Args:
        loaded: The scene.
        track: The recording.
        t: (n,) times.
        model: The model.
    """
    mujoco = mujoco_module()
    q = np.tile(np.array(model.qpos0), (len(t), 1))
    where: dict[int, Floats] = {}
    turned: dict[int, Floats] = {}
    kinds = mujoco.mjtSensor
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for name in loaded.names:
        if name not in track.sensors:
            continue
        sensor = int(model.sensor(name).id)
        kind, thing = int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
        if kind == kinds.mjSENS_JOINTPOS:
            q[:, model.jnt_qposadr[thing]] = track.sensors[name].smooth(t)[:, 0]
        elif kind in (kinds.mjSENS_FRAMEPOS, kinds.mjSENS_FRAMEQUAT):
            if int(model.sensor_refid[sensor]) >= 0:
                continue
            body, place, turn = _frame(
                mujoco, model, data, int(model.sensor_objtype[sensor]), thing
            )
            joint = int(model.body_jntadr[body])
            if joint < 0 or int(model.jnt_type[joint]) != 0:
                continue
            address = int(model.jnt_qposadr[joint])
            if kind == kinds.mjSENS_FRAMEQUAT:
                seen = track.sensors[name].smooth(t, True)
                q[:, address + 3 : address + 7] = product(seen, conjugate(turn)[None])
                turned[address] = seen
            else:
                q[:, address : address + 3] = track.sensors[name].smooth(t)
                where[address] = place
    for address, place in where.items():
        if np.any(place):
            at = q[:, address + 3 : address + 7]
            zero = np.zeros((len(t), 1))
            carried = product(product(at, np.concatenate([zero, zero + place], 1)), conjugate(at))
            q[:, address : address + 3] -= carried[:, 1:]
    return q


def _frame(mujoco: Any, model: Any, data: Any, kind: int, thing: int) -> tuple[int, Floats, Floats]:
    """Body of a frame, and where the frame is in it, m and as a quaternion."""
    kinds = mujoco.mjtObj
    at_rest = np.array([1.0, 0.0, 0.0, 0.0])
    if kind == kinds.mjOBJ_BODY:
        return thing, np.array(model.body_ipos[thing]), np.array(model.body_iquat[thing])
    if kind == kinds.mjOBJ_SITE:
        body = int(model.site_bodyid[thing])
        return body, np.array(model.site_pos[thing]), np.array(model.site_quat[thing])
    if kind == kinds.mjOBJ_GEOM:
        body = int(model.geom_bodyid[thing])
        return body, np.array(model.geom_pos[thing]), np.array(model.geom_quat[thing])
    return thing, np.zeros(3), at_rest


def _near(model: Any, q: Floats, near_m: float) -> NDArray[np.bool_]:
    """(n - 1,) whether anything is near anything between two instants."""
    mujoco = mujoco_module()
    widened = mujoco.MjModel.__copy__(model)
    widened.geom_margin[:] += near_m
    data = mujoco.MjData(widened)
    touches = np.zeros(len(q), dtype=bool)
    for i, at in enumerate(q):
        data.qpos[:] = at
        mujoco.mj_fwdPosition(widened, data)
        touches[i] = data.ncon > 0
    return touches[:-1] | touches[1:]
