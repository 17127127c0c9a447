# SPDX-License-Identifier: Apache-2.0
"""``mujoco.sysid`` on recorded tosses: a scene's parameters by roll-outs over the whole toss."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pneu_sysid.contacts.estimate import parameters_of
from pneu_sysid.contacts.foresee import Foreseen
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.scene import Loaded, Value

FIRST = 8
"""Readings by which a recording's own zero is told."""


def available() -> bool:
    """Whether ``mujoco.sysid`` is installed with what it needs."""
    try:
        from mujoco import sysid
    except ImportError:
        return False
    return hasattr(sysid, "optimize")


def zero(foreseen: Foreseen, sensor: str, model: Any) -> NDArray[np.float64]:
    """(w,) the recording's own zero of a sensor, as it begins; zero where it has none.

    ``mujoco.sysid`` has no zeros that differ from one recording to the next.

    Args:
        foreseen: The recording, foretold: it begins as it was read, but for that zero.
        sensor: The sensor.
        model: The model that foretold it.
    """
    chain = foreseen.chain
    channel = next(c for c in chain.channels if c.name == sensor)
    out = np.zeros(channel.width)
    if channel.unzeroed:
        first = channel.knots[:FIRST]
        said = Physics(1).evaluate(model, foreseen.motion.whole(chain.start))[1]
        should = said[first, channel.address : channel.address + channel.width]
        read = foreseen.track.sensors[sensor].at(chain.time_s[first])
        at = list(channel.unzeroed)
        out[at] = np.median(read - should, axis=0)[at]
    return out


def fitted(
    loaded: Loaded, begun: Sequence[Foreseen], values: tuple[Value, ...]
) -> tuple[Value, ...]:
    """The scene's parameters as ``mujoco.sysid`` finds them, with its defaults.

    It estimates no trajectory: each toss begins where this project's estimate of its first moments
    has it, and is rolled out whole.

    Args:
        loaded: The scene.
        begun: Each recording, foretold from its first moments.
        values: The scene's effects, from which it starts.

    Returns:
        The effects with what it found.
    """
    from mujoco import sysid

    own = parameters_of(loaded, values)
    spec = loaded.setup(values).spec
    model = spec.compile()
    start = {p.label: p.coordinate(p.effect.value(loaded.setup(values), p.place)) for p in own}

    def valued(at: Any) -> tuple[Value, ...]:
        out = {(v.effect, v.at): v for v in values}
        for p in own:
            found = float(np.clip(p.value(float(at[p.label].value[0])), p.lower, p.upper))
            out[p.effect.name, p.place] = out[p.effect.name, p.place].but(value=found)
        return tuple(out.values())

    def build(at: Any, _: Any) -> Any:
        return loaded.setup(valued(at)).spec.compile()

    states, controls, readings, names = [], [], [], []
    for f in begun:
        t = f.track.sensors[loaded.names[0]].time_s
        states.append(sysid.create_initial_state(model, f.motion.q[0], f.motion.v[0]))
        controls.append(sysid.TimeSeries(t - t[0], np.zeros((len(t), model.nu)), {}))
        table = np.concatenate(
            [f.track.sensors[name].values - zero(f, name, model) for name in loaded.names], axis=1
        )
        readings.append(
            sysid.TimeSeries.from_names(t - t[0], table, model, names=list(loaded.names))
        )
        names.append(f.track.name)
    group = sysid.ModelSequences(loaded.scene.name, spec, names, states, controls, readings)
    parameters = sysid.ParameterDict(
        {
            p.label: sysid.Parameter(
                p.label, start[p.label], p.coordinate(p.lower), p.coordinate(p.upper)
            )
            for p in own
        }
    )
    residual = sysid.build_residual_fn(models_sequences=[group], build_model=build)
    found, _ = sysid.optimize(
        parameters, residual, verbose=False, max_iters=50, output=io.StringIO()
    )
    return valued(found)
