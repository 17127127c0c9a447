# SPDX-License-Identifier: Apache-2.0
"""Trajectory and parameters of what touches, estimated together: time, memory, and peers.

Each figure is of a process of its own, so that its memory is too: ``python -m benchmarks.contacts
NAME SECONDS`` prints one as JSON.
"""

from __future__ import annotations

import importlib.util
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.report import ROOT, Table

Floats = NDArray[np.float64]

RATE_HZ = 200.0
FINE_S = 1e-3
ITERATIONS = 30
FRICTION = 0.4
START = 0.6
"""Friction at which every search begins."""

LINK = (
    '<body pos="0 0 {z}"><joint name="{f}{k}" axis="{axis}" damping="0.05" armature="0.001"/>'
    '<geom type="capsule" fromto="0 0 0 0 0 -0.06" size="0.008" mass="0.05" contype="0"'
    ' conaffinity="0"/>'
)
TIP = (
    '<body pos="0 0 -0.06"><geom name="tip{f}" type="sphere" size="0.01" mass="0.02"/>'
    '<site name="tip{f}"/></body>'
)


def finger(name: str, place: str) -> str:
    """One of four hinges, with a tip that feels."""
    axes = ("1 0 0", "0 1 0", "0 1 0", "0 1 0")
    links = "".join(
        LINK.format(z=0 if k == 0 else -0.06, f=name, k=k, axis=axis) for k, axis in enumerate(axes)
    )
    return f'<body pos="{place}">{links}{TIP.format(f=name)}{"</body>" * 4}</body>'


def mjcf() -> str:
    """Two fingers that push a box about: fourteen degrees of freedom."""
    joints = [f"{f}{k}" for f in "ab" for k in range(4)]
    motors = "".join(f'<position name="m{j}" joint="{j}" kp="6"/>' for j in joints)
    angles = "".join(f'<jointpos name="q{j}" joint="{j}"/>' for j in joints)
    return f"""<mujoco><option timestep="{FINE_S}" cone="elliptic" impratio="10"/>
<default><geom friction="{FRICTION} 0.005 0.0001" solref="-4000 -120" solimp="0 0.95 0.004 1 2"/>
</default><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
{finger("a", "-0.07 0 0.28")}{finger("b", "0.07 0 0.28")}
<body name="box" pos="0 0 0.03"><freejoint name="box"/>
<geom name="box" type="box" size="0.04 0.04 0.03" mass="0.3"/></body></worldbody>
<actuator>{motors}</actuator><sensor>{angles}
<framepos name="place" objtype="body" objname="box"/>
<framequat name="turn" objtype="body" objname="box"/>
<force name="feela" site="tipa"/><force name="feelb" site="tipb"/></sensor></mujoco>"""


def commands(t_s: Floats) -> Floats:
    """(n, 8) where joints are told to be: fingers that push the box to and fro, and sideways."""
    out = np.zeros((len(t_s), 8))
    to_and_fro = 0.3 * np.sin(2.0 * np.pi * 0.43 * t_s)
    for first, side in ((0, 1.0), (4, -1.0)):
        out[:, first] = side * 0.1 * np.sin(2.0 * np.pi * 0.31 * t_s)
        out[:, first + 1] = to_and_fro - 0.05 * side
        out[:, first + 2] = 0.05 * np.sin(2.0 * np.pi * 0.7 * t_s + side)
    return out


def recorded(seconds: float) -> tuple[Floats, Floats, Floats, Floats]:
    """Simulated at 1 ms and recorded at 200 Hz: times, sensors, commands, state at the start."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(mjcf())
    data = mujoco.MjData(model)
    every = round(1.0 / RATE_HZ / FINE_S)
    settle = 200
    steps = round(seconds / FINE_S)
    drive = commands(FINE_S * (np.arange(steps + settle + every) - settle))
    rows, told, state = [], [], np.zeros(0)
    for k in range(steps + settle):
        data.ctrl[:] = drive[k - k % every] if k >= settle else drive[settle]
        if k == settle:
            kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
            state = np.empty(mujoco.mj_stateSize(model, kind))
            mujoco.mj_getState(model, data, state, kind)
        if k >= settle and (k - settle) % every == 0:
            mujoco.mj_forward(model, data)
            rows.append(data.sensordata.copy())
            told.append(data.ctrl.copy())
        mujoco.mj_step(model, data)
    table = np.array(rows)
    rng = np.random.default_rng(0)
    noise = np.array([1e-4] * 8 + [1e-4] * 3 + [1e-3] * 4 + [0.02] * 6)
    table = table + noise * rng.normal(size=table.shape)
    return np.arange(len(table)) / RATE_HZ, table, np.array(told), state


def scene(folder: Path) -> Any:
    """The scene of the recording, friction unknown."""
    from pneu_sysid.contacts.scene import (
        ControlSettings,
        ForceSettings,
        KnotSettings,
        Loaded,
        NormSettings,
        Scene,
        SensorSettings,
        Value,
    )

    (folder / "fingers.xml").write_text(mjcf(), encoding="utf-8")

    def norm(std: float) -> NormSettings:
        return NormSettings(std=std, kind="square")

    joints = [f"{f}{k}" for f in "ab" for k in range(4)]
    sensors = {f"q{j}": SensorSettings(columns=("x",), norm=norm(1e-4)) for j in joints}
    sensors["place"] = SensorSettings(columns=tuple("xyz"), norm=norm(1e-4))
    sensors["turn"] = SensorSettings(columns=tuple("wxyz"), norm=norm(1e-3))
    for f in "ab":
        sensors[f"feel{f}"] = SensorSettings(columns=tuple("xyz"), norm=norm(0.02))
    forces = {j: ForceSettings(along=norm(2e-3)) for j in joints}
    forces["box"] = ForceSettings(translation=norm(0.03), rotation=norm(1e-3))
    return Loaded(
        Scene(
            name="fingers",
            mjcf="fingers.xml",
            sensors=sensors,
            controls={f"m{j}": ControlSettings(column=j) for j in joints},
            forces=forces,
            values=(Value(effect="contact_friction", at="all", value=START),),
            knots=KnotSettings(step_s=1.0 / RATE_HZ),
        ),
        folder,
    )


def problem_of(seconds: float, folder: Path) -> Any:
    """The estimate's problem, and where it starts."""
    from pneu_sysid.contacts.estimate import Problem, parameters_of
    from pneu_sysid.contacts.physics import Physics
    from pneu_sysid.contacts.track import Series, Track, unbroken
    from pneu_sysid.contacts.trajectories import begun

    loaded = scene(folder)
    t, table, told, _ = recorded(seconds)
    joints = [f"{f}{k}" for f in "ab" for k in range(4)]
    parts = {f"q{j}": table[:, k : k + 1] for k, j in enumerate(joints)}
    parts |= {"place": table[:, 8:11], "turn": unbroken(table[:, 11:15])}
    parts |= {"feela": table[:, 15:18], "feelb": table[:, 18:21]}
    track = Track(
        "fingers",
        {name: Series(t, values) for name, values in parts.items()},
        {f"m{j}": Series(t, told[:, k : k + 1]) for k, j in enumerate(joints)},
    )
    physics = Physics()
    chains, q = begun(loaded, [track], loaded.scene.values, physics)
    values = loaded.scene.values
    return Problem(loaded, chains, values, parameters_of(loaded, values), physics, False), q


def ours(seconds: float, folder: Path) -> dict[str, Any]:
    """The joint estimate."""
    from pneu_sysid.contacts.estimate import State, estimate

    problem, q = problem_of(seconds, folder)
    begun = time.perf_counter()
    found = estimate(problem, State(q, problem.start()), ITERATIONS)
    taken = time.perf_counter() - begun
    chain = problem.chains[0]
    return {
        "unknowns": chain.size * chain.manifold.nv + len(found.parameters),
        "iteration_s": taken / found.iterations,
        "solve": found.seconds["solve"] / taken,
        "friction": found.parameters[0].value(found.state.x[0]),
    }


def scipy_dense(seconds: float, folder: Path) -> dict[str, Any]:
    """The same residuals by SciPy's dense least squares, which differences them itself."""
    from scipy.optimize import least_squares

    problem, q = problem_of(seconds, folder)
    chain = problem.chains[0]
    size = chain.size * chain.manifold.nv
    start = problem.start()
    weight = np.sqrt(2.0 * np.array([norm.weight for norm in chain.norms()]))

    def residuals(step: Floats) -> Floats:
        model, setup = problem.model(start + step[size:])
        moved = chain.manifold.moved(q[0], step[:size].reshape(chain.size, -1))
        said = chain.outputs(moved, model, setup, problem.physics)
        rows = np.concatenate(chain.rows(said, setup), axis=1) * weight
        return rows[np.isfinite(rows)]

    begun = time.perf_counter()
    found = least_squares(residuals, np.zeros(size + len(start)), max_nfev=2)
    taken = time.perf_counter() - begun
    return {
        "unknowns": size + len(start),
        "iteration_s": taken / found.njev,
        "friction": problem.parameters[0].value((start + found.x[size:])[0]),
    }


def mujoco_sysid(seconds: float, folder: Path) -> dict[str, Any]:
    """MuJoCo's own: friction alone, by roll-outs from the true state at the start."""
    import mujoco
    from mujoco import sysid

    t, table, told, state = recorded(seconds)
    spec = mujoco.MjSpec.from_string(mjcf())
    model = spec.compile()
    group = sysid.ModelSequences(
        "fingers",
        spec,
        "first",
        state,
        sysid.TimeSeries.from_control_names(t, told, model),
        sysid.TimeSeries.from_names(t, table, model),
    )

    def put(spec: Any, parameter: Any) -> None:
        for geom in spec.geoms:
            geom.friction[0] = parameter.value[0]

    parameters = sysid.ParameterDict(
        {"friction": sysid.Parameter("friction", START, 0.01, 2.0, modifier=put)}
    )
    residual = sysid.build_residual_fn(models_sequences=[group])
    begun = time.perf_counter()
    found, result = sysid.optimize(
        parameters, residual, optimizer="scipy", verbose=False, max_iters=ITERATIONS
    )
    taken = time.perf_counter() - begun
    return {
        "unknowns": 1,
        "iteration_s": taken / result.njev,
        "friction": float(found.as_vector()[0]),
    }


WAYS = {"ours": ours, "scipy": scipy_dense, "mujoco": mujoco_sysid}


def one(name: str, seconds: float) -> dict[str, Any]:
    """Measures one way in this process."""
    with tempfile.TemporaryDirectory() as folder:
        row = WAYS[name](seconds, Path(folder))
    row["peak_gb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2.0**20
    return row


def measure() -> list[Table]:
    """Measures the joint estimate on long and short recordings, and peers where they can."""
    table = Table(
        "Contacts: trajectory and friction together",
        f"Two fingers of four hinges push a box, {RATE_HZ:g} Hz, fourteen degrees of freedom;"
        f" friction {FRICTION:g}, from {START:g}. Time of an iteration, the share of it that solves"
        " equations, and the largest memory of the process. SciPy's dense least squares has the"
        " same residuals and fits in memory for short recordings alone; `mujoco.sysid` finds the"
        " friction alone, from the true state at the start, by roll-outs over the whole recording"
        " at the step of the simulation.",
        {
            "way": "way",
            "seconds": "recording [s]",
            "unknowns": "unknowns",
            "iteration_s": "iteration [s]",
            "solve": "of it solving",
            "peak_gb": "memory [GiB]",
            "friction": "friction found",
        },
    )
    if importlib.util.find_spec("mujoco") is None:
        table.notes.append("MuJoCo is not installed here.")
        return [table]
    for name, title, seconds in (
        ("ours", "joint estimate", 20.0),
        ("ours", "joint estimate", 0.5),
        ("scipy", "SciPy, dense", 0.5),
        ("mujoco", "mujoco.sysid", 20.0),
        ("mujoco", "mujoco.sysid", 0.5),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.contacts", name, str(seconds)],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            why = (done.stderr.strip().splitlines() or ["it ended without a word"])[-1]
            table.notes.append(f"{title} was left out: {why}")
            continue
        row = json.loads(done.stdout.splitlines()[-1])
        table.rows.append({"way": title, "seconds": seconds, **row})
    return [table]


if __name__ == "__main__":
    print(json.dumps(one(sys.argv[1], float(sys.argv[2]))))
