# SPDX-License-Identifier: Apache-2.0
"""A recording as a chain of knots: residuals of forces and sensors, and what they change by.

Velocities are differences to the knot before and accelerations differences of those (thesis 2.3);
for even steps that is MuJoCo's semi-implicit Euler, so that a roll-out with the same step leaves
no residual. Where steps differ, an acceleration belongs to the mean of its two.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from pneu_sysid.contacts.arrow import Arrow, Zeros
from pneu_sysid.contacts.bearings import bearings_of
from pneu_sysid.contacts.effects.base import Reading, Setup
from pneu_sysid.contacts.manifold import (
    Manifold,
    conjugate,
    logarithm,
    product,
    turned_by,
)
from pneu_sysid.contacts.norms import Norm
from pneu_sysid.contacts.physics import Motion, Physics
from pneu_sysid.contacts.scene import Loaded
from pneu_sysid.contacts.track import Series

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
        unzeroed: Components whose zero is the recording's own and is found with the trajectory.
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
    unzeroed: tuple[int, ...] = ()

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
        near: (n,) whether bodies are near each other, as sensors alone tell.
        trust: (n,) what norms at a knot are multiplied by; 1 unless given.
        taken: (m, width) readings of each sensor at its knots, where its lag is known and they were
            taken once and for all.
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
    near: NDArray[np.bool_]
    trust: Floats | None = None
    taken: dict[str, Floats] | None = None

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
        return Motion(q, v, a, self.control)

    def outputs(self, q: Floats, model: Any, setup: Setup, physics: Physics) -> Outputs:
        """What a model says along a trajectory.

        Args:
            q: (n, nq).
            model: The model.
            setup: The scene it is made from.
            physics: What evaluates it.
        """
        motion = self.motion(q, setup)
        force, sensors = physics.evaluate(model, motion, bearings_of(model, setup.loaded))
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
        misread = np.asarray(should - read)
        for component in channel.unzeroed:
            trust = None if self.trust is None else self.trust[channel.knots]
            misread[:, component] -= level(misread[:, component], channel.norm, trust)
        return misread

    def measured(self, channel: Channel, told: Reading) -> Floats:
        """(m, width) readings of a sensor at its knots, of a lag later.

        Args:
            channel: The sensor.
            told: How it tells.
        """
        if self.taken is not None:
            return self.taken[channel.name]
        times = self.time_s[channel.knots] + told.lag_s
        if not channel.fast:
            return channel.series.at(times, channel.turns)
        edges = np.concatenate(
            [self.time_s[:1], 0.5 * (self.time_s[1:] + self.time_s[:-1]), self.time_s[-1:]]
        )
        low, high = edges[channel.knots] + told.lag_s, edges[channel.knots + 1] + told.lag_s
        return channel.series.mean_over(low, high)

    def rows(self, outputs: Outputs, setup: Setup, plain: bool = False) -> tuple[Floats, Floats]:
        """All residuals of a chain, a knot a row; NaN where there is none.

        Args:
            outputs: What the model says.
            setup: The scene.
            plain: Forces as they are, not by what their slack makes them count.

        Returns:
            (n, nv) of forces, and (n, R) of sensors, one after another.
        """
        force = self.forces(outputs, setup) / (1.0 if plain else self.slack)
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
        return float(np.sum(self.costs(outputs, setup)))

    def costs(self, outputs: Outputs, setup: Setup) -> Floats:
        """(n,) sum of norms at each knot.

        Args:
            outputs: What the model says.
            setup: The scene.
        """
        rows = np.concatenate(self.rows(outputs, setup), axis=1)
        there = np.isfinite(rows)
        rows = np.where(there, rows, 0.0)
        total = np.zeros(self.size)
        for k, norm in enumerate(self.norms()):
            total += np.where(there[:, k], norm.cost(rows[:, k]), 0.0)
        return total if self.trust is None else total * self.trust

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
        total = sum(np.where(there[:, i], norm.cost(r[:, i]), 0.0) for i, norm in enumerate(norms))
        if self.trust is not None:
            bend *= self.trust[:, None]
            slope *= self.trust[:, None]
            total = total * self.trust
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
        flat = P.reshape(n * len(norms), len(columns))
        Z = self._zeros(there)
        zeros = None
        if Z.shape[2]:
            own, heavy = Z.reshape(n * len(norms), -1), bend.reshape(-1, 1)
            zeros = Zeros(
                _by_knot(np.swapaxes(weighed, 1, 2) @ Z, k),
                flat.T @ (own * heavy),
                own.T @ (own * heavy),
            )
        return Arrow(
            diagonal=diagonal,
            next=after_one,
            after=after_two,
            shaft=_by_knot(S, k),
            tip=flat.T @ (flat * bend.reshape(-1, 1)),
            slope=_by_knot(G, k),
            tip_slope=flat.T @ slope.ravel(),
            cost=float(np.sum(total)),
            zeros=zeros,
        )

    def _zeros(self, there: NDArray[np.bool_]) -> Floats:
        """(n, outputs, z) what residuals change by with zeros that are the recording's own."""
        own = []
        at = len(self.dof_norms)
        for channel in self.channels:
            own += [at + component for component in channel.unzeroed]
            at += channel.size
        out = np.zeros((*there.shape, len(own)))
        for z, row in enumerate(own):
            out[:, row, z] = there[:, row]
        return out

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
        slopes = physics.slopes(model, motion, centred, bearings_of(model, setup.loaded))
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


def _by_knot(of: Floats, k: int) -> Floats:
    """(n, k, ...) what residuals say by the knot that they say it of, not by the middle of three.

    Args:
        of: (n, 3 k, ...) by the knot before, a residual's own, and the next.
        k: Directions of a knot.
    """
    out = of[:, k : 2 * k].copy()
    out[:-1] += of[1:, :k]
    out[1:] += of[:-1, 2 * k :]
    return out


def level(misread: Floats, norm: Norm, trust: Floats | None = None) -> float:
    """The zero that makes readings least wrong.

    Args:
        misread: (m,) what is read too little.
        norm: How it is weighed.
        trust: (m,) what each counts by; all alike unless given.
    """
    by = np.ones_like(misread) if trust is None else trust
    low, high = float(np.min(misread, initial=np.inf)), float(np.max(misread, initial=-np.inf))
    if not low < high or not np.isfinite(high - low):
        return low if np.isfinite(low) else 0.0
    return float(
        brentq(lambda m: float(np.sum(by * norm.slope(misread - m))), low, high, xtol=1e-15)
    )


def _turn_of(q: Floats) -> Floats:
    """(m, 3, 4): rotation vector, in the turned frame, per change of quaternions."""
    w, x, y, z = (q[:, i] for i in range(4))
    rows = [
        np.stack([-x, w, z, -y], axis=1),
        np.stack([-y, -z, w, x], axis=1),
        np.stack([-z, y, -x, w], axis=1),
    ]
    return 2.0 * np.stack(rows, axis=1)


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
        share[first : first + wide] = loaded.forces_of(model, j).of_contact
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


LEAST = 1e-3
"""Cost per knot below which norms say that all is worse than it is."""


def by_kind(chain: Chain, outputs: Outputs, setup: Setup) -> Floats:
    """(2,) mean cost per knot, far from everything and near something; NaN where there is none.

    Args:
        chain: The chain.
        outputs: What the model says.
        setup: The scene.
    """
    cost = replace(chain, trust=None).costs(outputs, setup)
    return np.array(
        [np.mean(cost[at]) if np.any(at) else np.nan for at in (~chain.near, chain.near)]
    )
