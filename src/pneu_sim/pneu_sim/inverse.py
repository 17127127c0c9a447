# SPDX-License-Identifier: Apache-2.0
"""Inverse dynamics of a rig's bodies: what gas must push with for a motion (thesis 9.2.4).

The equations are those that the simulator moves bodies by, solved for the forces of cylinders in
place of accelerations. It takes what the rig file says of masses and friction.
"""

import numpy as np
from numpy.typing import NDArray

from pneu_common.errors import InputError
from pneu_sim import layout as L
from pneu_sim.compiling import compiled
from pneu_sim.kernel.equations.kinds import levers, mechanics
from pneu_sim.rig.build import build
from pneu_sim.rig.schema import Rig

Floats = NDArray[np.float64]

SLOW = 0.02
"""Dry friction turns round within about this speed, rad/s or m/s, so that plans have no jumps."""


@compiled
def _of_bodies(
    table: NDArray[np.int64],
    par: Floats,
    q: Floats,
    v: Floats,
    a: Floats,
    torque: Floats,
    extension: Floats,
    lever: Floats,
) -> None:
    """Torques that a motion needs without friction, ways of pistons and their levers."""
    joints, places = lever.shape[2], lever.shape[1]
    mass, force = np.zeros((joints, joints)), np.zeros(joints)
    x, arms = np.zeros(places), np.zeros((places, joints))
    for k in range(q.shape[0]):
        for b in range(table.shape[0]):
            kind, first, n = table[b, L.B_KIND], table[b, L.B_JOINT], table[b, L.B_JOINTS]
            place, m = table[b, L.B_PLACE], table[b, L.B_PLACES]
            mechanics(
                kind, par, b, 0, q[k, first : first + n], v[k, first : first + n], mass, force
            )
            levers(kind, par, b, 0, q[k, first : first + n], x, arms)
            for i in range(n):
                torque[k, first + i] = -force[i]
                for j in range(n):
                    torque[k, first + i] += mass[i, j] * a[k, first + j]
            for c in range(m):
                extension[k, place + c] = x[c]
                for i in range(n):
                    lever[k, place + c, first + i] = arms[c, i]


class InverseDynamics:
    """The bodies of a rig, each joint that is not held moved by a cylinder.

    Attributes:
        joints: Names of all joints.
        cylinders: Names of the cylinders that move them.
    """

    def __init__(self, rig: Rig) -> None:
        """Reads the rig.

        Args:
            rig: The rig; its effects are worked in.

        Raises:
            InputError: It has a mechanism, no bodies, or not as many cylinders as free joints.
        """
        if rig.mechanism is not None or not rig.bodies:
            raise InputError(
                f"rig {rig.name!r}: inverse dynamics are those of bodies, it has"
                f" {'a mechanism' if rig.mechanism is not None else 'none'}"
            )
        model = build(rig)
        plan = model.plan
        self.joints = list(plan.joints)
        self.cylinders = [plan.cylinders[k] for k in plan.driven_by]
        self._table, self._par = plan.body, model.body[:, :, None].copy()
        self._joint, self._cylinder = model.joint, model.cylinder[plan.driven_by]
        self._free = np.flatnonzero(self._joint[:, L.PJ_HELD] == 0.0)
        if len(self._free) != len(self.cylinders):
            raise InputError(
                f"rig {rig.name!r}: found {len(self.cylinders)} cylinders that move"
                f" {len(self._free)} joints; a force is only told where there are as many"
            )

    def required(self, q: Floats, v: Floats, a: Floats) -> tuple[Floats, Floats]:
        """What the gas must push with, friction included.

        Args:
            q: (n, joints) positions, rad or m; held joints stand where the rig says, whatever this.
            v: (n, joints) velocities.
            a: (n, joints) accelerations.

        Returns:
            (n, cylinders) forces of gas and room on pistons, N (or N m), and (n, cylinders)
            extensions, m (or rad).
        """
        n = len(q)
        held = self._joint[:, L.PJ_HELD] > 0.0
        q = np.where(held, self._joint[:, L.PJ_START], q)
        v, a = np.where(held, 0.0, v), np.where(held, 0.0, a)
        torque = np.zeros((n, len(self.joints)))
        extension = np.zeros((n, len(self.cylinders)))
        lever = np.zeros((n, len(self.cylinders), len(self.joints)))
        _of_bodies(self._table, self._par, q, v, a, torque, extension, lever)
        j, c = self._joint, self._cylinder
        torque += j[:, L.PJ_DAMPING] * v + j[:, L.PJ_FRICTION] * np.tanh(v / SLOW)
        torque += j[:, L.PJ_SPRING] * (q - j[:, L.PJ_REST])
        arms = lever[:, :, self._free]
        wanted = torque[:, self._free, None]
        force: Floats = np.array(np.linalg.solve(arms.transpose(0, 2, 1), wanted)[:, :, 0])
        speed = np.einsum("ncj,nj->nc", lever, v)
        dry = c[:, L.PY_COULOMB] + c[:, L.PY_BREAKAWAY] * np.exp(
            -((speed / c[:, L.PY_STRIBECK]) ** 2)
        )
        force += c[:, L.PY_VISCOUS] * speed + dry * np.tanh(speed / SLOW)
        force += c[:, L.PY_SPRING] * extension + c[:, L.PY_PRELOAD]
        return force, extension

    def strokes(self) -> Floats:
        """(cylinders,) strokes, m or rad."""
        return np.array(self._cylinder[:, L.PY_STROKE])

    def strongest(self, high_pa: float, low_pa: float) -> tuple[Floats, Floats]:
        """Least and greatest force of every piston with its sides at two pressures, N.

        Args:
            high_pa: The higher pressure, Pa.
            low_pa: The lower, Pa.
        """
        c = self._cylinder
        head, rod = c[:, L.PY_AREA], c[:, L.PY_AREA_ROD]
        room = c[:, L.PY_ROOM_P]
        least = (low_pa - room) * head - (high_pa - room) * rod
        most = (high_pa - room) * head - (low_pa - room) * rod
        return least, most
