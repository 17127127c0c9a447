# SPDX-License-Identifier: Apache-2.0
"""How an observer is set; see `pneu_sim.observe.observer`."""

from typing import Annotated

from pydantic import Field

from pneu_common.validation import Settings

LEAK_S = 20.0
"""Over which a leak forgets how large it was, s."""
LOAD_S = 20.0
"""Over which a load is forgotten, s: it is taken up and put down."""


class Drift(Settings):
    """How far a number that is not well known may wander, as a first-order Markov process.

    Attributes:
        std: Its standard deviation about what the rig file says, in its own unit.
        time_s: Over which it forgets where it was, s.
    """

    std: Annotated[float, Field(ge=0.0)]
    time_s: Annotated[float, Field(gt=0.0)]


class ObserverSettings(Settings):
    """How the state of a rig is followed.

    Attributes:
        members: Rigs side by side.
        seed: Of all draws.
        dx_m: Cell length, m; None is the rig's own.
        fewest_cells: Cells that the shortest pipe has at least; with 1 steps of coarse grids are
            longest.
        reach_m: How far along lines a reading corrects the gas, m: half of the support of the
            Gaspari-Cohn function. What lies behind a valve is corrected through what drifts alone.
        command: Wandering of every valve's command, V: what the model of a spool gets wrong.
        null: Drift of every valve's null, V.
        flow: Wandering of what every port lets through, as a share: what the model of a valve gets
            wrong.
        gain: Drift of the same, as a share.
        supply: Drift of the pressure of every reservoir that is no room, as a share.
        delay: Drift of every valve's delay, s.
        dead_band: Drift of every valve's dead band to either side, V.
        hysteresis: Drift of every valve's backlash, full width, V.
        bandwidth: Drift of every spool's bandwidth, as a share.
        lag: Drift of every tap's lag, s.
        leak: Drift of the effective area of a leak in every line, m^2; there is none below zero.
        load: Drift of a point mass that every joint which may be loaded carries besides what its
            file says, kg; there is none below zero.
        load_at: Drift of how far that is from a rotary joint, m.
        load_at_m: How far it is unless readings say otherwise, m.
        noise_pa: Noise of taps whose noise no file tells, one sigma, Pa.
        noise_position: Noise of encoders whose noise no file tells, rad or m.
        timing_s: How much a reading and the model may be apart in time, s: what stamps and the
            speed of steep waves in cells are wrong by.
        start_std_pa: How little the pressures of a beginning are known between the readings, Pa;
            speeds likewise, by what a wave of that height has.
        start_std_k: Likewise temperatures, K.
        start_speed: Likewise speeds of joints, rad/s or m/s.
        gate: Innovations beyond this many standard deviations count less.
        hard_gate: Beyond this many a single sensor is not believed at once.
        patience_s: So long a sensor is beyond the gate before it is left out, s.
        agreeing: Most root mean square of the others' innovations that lets them overrule one, in
            standard deviations.
        return_s: So long one that is out has to agree before it is believed again, s.
        watch_s: Over which the innovations are looked at, s.
        settle_s: For so long after a beginning no sensor is left out and nothing is improbable, s.
        improbable: Root mean square of innovations over that while from which on the model is said
            to be wrong, in standard deviations.
        improbable_mean: Likewise of their mean over that while.
        slow_s: What forgets over so long or longer is watched for drift, s.
        most_drift: Drift from which on the model is said to be wrong, in standard deviations.
    """

    members: Annotated[int, Field(ge=4, le=64)] = 16
    seed: Annotated[int, Field(ge=0)] = 0
    dx_m: Annotated[float, Field(gt=0.0)] | None = None
    fewest_cells: Annotated[int, Field(ge=1)] = 2
    reach_m: Annotated[float, Field(gt=0.0)] = 2.5
    command: Drift = Drift(std=0.005, time_s=0.03)
    null: Drift = Drift(std=0.02, time_s=20.0)
    flow: Drift = Drift(std=0.1, time_s=0.02)
    gain: Drift = Drift(std=0.0, time_s=20.0)
    supply: Drift = Drift(std=0.003, time_s=20.0)
    delay: Drift = Drift(std=0.0, time_s=20.0)
    dead_band: Drift = Drift(std=0.0, time_s=20.0)
    hysteresis: Drift = Drift(std=0.0, time_s=20.0)
    bandwidth: Drift = Drift(std=0.0, time_s=20.0)
    lag: Drift = Drift(std=0.0, time_s=20.0)
    leak: Drift = Drift(std=0.0, time_s=LEAK_S)
    load: Drift = Drift(std=0.0, time_s=LOAD_S)
    load_at: Drift = Drift(std=0.1, time_s=LOAD_S)
    load_at_m: Annotated[float, Field(ge=0.0)] = 0.2
    noise_pa: Annotated[float, Field(gt=0.0)] = 250.0
    noise_position: Annotated[float, Field(gt=0.0)] = 1e-3
    timing_s: Annotated[float, Field(ge=0.0)] = 1e-4
    start_std_pa: Annotated[float, Field(gt=0.0)] = 1e4
    start_std_k: Annotated[float, Field(gt=0.0)] = 3.0
    start_speed: Annotated[float, Field(gt=0.0)] = 0.3
    gate: Annotated[float, Field(gt=1.0)] = 6.0
    hard_gate: Annotated[float, Field(gt=1.0)] = 30.0
    patience_s: Annotated[float, Field(gt=0.0)] = 0.05
    agreeing: Annotated[float, Field(gt=0.0)] = 2.0
    return_s: Annotated[float, Field(gt=0.0)] = 0.1
    watch_s: Annotated[float, Field(gt=0.0)] = 0.25
    settle_s: Annotated[float, Field(ge=0.0)] = 0.5
    improbable: Annotated[float, Field(gt=1.0)] = 4.0
    improbable_mean: Annotated[float, Field(gt=0.0)] = 1.4
    slow_s: Annotated[float, Field(gt=0.0)] = 1.0
    most_drift: Annotated[float, Field(gt=1.0)] = 4.0
