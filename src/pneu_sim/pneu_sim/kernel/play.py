# SPDX-License-Identifier: Apache-2.0
"""Play between a piston and the joints that it drives: it leans on one face, or is loose between.

With half the play added to the joint's angle a piston pushes, with half of it taken away it pulls;
leaning, it moves with its body as without play. Once the force at its face would have to hold it
back it is loose, and moves by its own mass until it meets a face, where its speed relative to the
body is lost (an inelastic impact). The force is that of the last step.
"""

from pneu_sim import layout as L
from pneu_sim.compiling import folded
from pneu_sim.kernel.equations.kinds import levers

LEANS, LOOSE = 1.0, 2.0
"""What ``Bodies.loose`` says of a piston with play; 0 has none."""


@folded
def has_play(b, j, bodies):
    """Whether any joint of a body has play.

    Args:
        b: Which body.
        j: Which lane.
        bodies: Bodies.
    """
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    widest = 0.0
    for i in range(n):
        widest = max(widest, bodies.joint[first + i, L.PJ_PLAY, j])
    return widest > 0.0


@folded
def look_from(b, j, c, side, bodies):
    """Extension and levers of place c with its joints moved to a face of their play, as scratch.

    Returns the extension; ``bodies.there_lever[c]`` has the levers. ``bodies.q`` is left as it was.

    Args:
        b: Which body.
        j: Which lane.
        c: Which of its places.
        side: 1 where the piston pushes, -1 where it pulls.
        bodies: Bodies, with levers at ``bodies.q``.
    """
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    for i in range(n):
        half = 0.5 * side * bodies.joint[first + i, L.PJ_PLAY, j]
        bodies.there_q[i] = bodies.q[i] + (half if bodies.lever[c, i] > 0.0 else -half)
    levers(
        bodies.table[b, L.B_KIND],
        bodies.par,
        b,
        j,
        bodies.there_q,
        bodies.there_x,
        bodies.there_lever,
    )
    return bodies.there_x[c]


@folded
def is_played(b, j, c, bodies):
    """Whether a joint that a place drives has play; by the levers at ``bodies.q``.

    Args:
        b: Which body.
        j: Which lane.
        c: Which of its places.
        bodies: Bodies.
    """
    first, n = bodies.table[b, L.B_JOINT], bodies.table[b, L.B_JOINTS]
    for i in range(n):
        if bodies.joint[first + i, L.PJ_PLAY, j] > 0.0 and bodies.lever[c, i] != 0.0:
            return True
    return False


@folded
def lean(b, j, bodies, cylinders):
    """Extensions and levers of pistons with play as they now lean; those that are loose have none.

    Args:
        b: Which body.
        j: Which lane.
        bodies: Bodies, with extensions and levers at ``bodies.q``, which are changed.
        cylinders: Cylinders.
    """
    n = bodies.table[b, L.B_JOINTS]
    place, places = bodies.table[b, L.B_PLACE], bodies.table[b, L.B_PLACES]
    for c in range(places):
        bodies.loose[c] = 0.0
        if not is_played(b, j, c, bodies):
            continue
        k = bodies.driven_by[place + c]
        side = cylinders.state[k, L.SY_SIDE, j]
        bodies.loose[c] = LOOSE if side == 0.0 else LEANS
        if side == 0.0:
            bodies.x[c] = cylinders.state[k, L.SY_EXTENSION, j]
            for i in range(n):
                bodies.lever[c, i] = 0.0
            continue
        x = look_from(b, j, c, side, bodies)
        bodies.x[c] = x
        for i in range(n):
            bodies.lever[c, i] = bodies.there_lever[c, i]


@folded
def stay_within(b, j, bodies, cylinders):
    """Put pistons with play, wherever their bodies were put, within it.

    Args:
        b: Which body.
        j: Which lane.
        bodies: Bodies, with extensions and levers at ``bodies.q``, which are changed.
        cylinders: Cylinders.
    """
    place, places = bodies.table[b, L.B_PLACE], bodies.table[b, L.B_PLACES]
    for c in range(places):
        k = bodies.driven_by[place + c]
        if cylinders.state[k, L.SY_SIDE, j] != 0.0 or not is_played(b, j, c, bodies):
            continue
        low = look_from(b, j, c, -1.0, bodies)
        high = look_from(b, j, c, 1.0, bodies)
        x = cylinders.state[k, L.SY_EXTENSION, j]
        cylinders.state[k, L.SY_EXTENSION, j] = min(max(x, low), high)
    lean(b, j, bodies, cylinders)
