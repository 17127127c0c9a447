# SPDX-License-Identifier: Apache-2.0
"""Scenes and recordings that cannot be: one clear sentence each."""

import importlib.metadata
import json
import re
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner, Result

from pneu_common.cli import COMMANDS_GROUP, build_app
from pneu_common.errors import InputError
from pneu_sysid.contacts.fit import fit_scene
from pneu_sysid.contacts.physics import Physics
from pneu_sysid.contacts.read import read_track, read_tracks
from pneu_sysid.contacts.scene import load_scene, save_scene
from pneu_sysid.results.files import result_of
from pneu_sysid.results.scenes import SceneCompareResult, SceneFitResult

HOUSE = Path(__file__).resolve().parents[3]
HEAD = "x,y,z,qw,qx,qy,qz"


@pytest.fixture
def scenes(tmp_path: Path) -> Path:
    for name in ("cube.xml", "cube.yaml", "elbow.xml", "elbow.yaml"):
        shutil.copy(HOUSE / "scenes" / name, tmp_path / name)
    return tmp_path


def table(rows: int = 20, **columns: float) -> str:
    lines = [HEAD]
    for k in range(rows):
        row = {"x": 0.01 * k, "y": 0.0, "z": 2.0, "qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0}
        lines.append(",".join(str(v) for v in (row | columns).values()))
    return "\n".join(lines)


def changed(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return path


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("position:\n    columns", "place:\n    columns", r"no sensor 'place'; it has position"),
        ("  cube:\n    trans", "  cub:\n    trans", r"no joint 'cub'; it has cube"),
        ("at: all", "at: floor", r"contact_friction: no place 'floor' in cube.xml; there are all"),
        ("contact_friction", "contact_fric", r"did you mean 'contact_friction'\?"),
        ("[x, y, z]", "[x, y]", r"position: has 3 components in cube.xml, found 2 columns"),
        ("rate_hz", "rate_khz", r"unknown key 'rate_khz'; did you mean 'rate_hz'\?"),
        ("pneu_scene: 1", "pneu_scene: 7", r"pneu_scene: found 7, this version reads 1"),
        ("mjcf: cube.xml", "mjcf: none.xml", r"none.xml: no such MJCF"),
        ("{std: 0.02", "{std: -0.02", r"greater than 0"),
    ],
)
def test_a_scene_that_is_not_of_its_mjcf(scenes: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        load_scene(changed(scenes / "cube.yaml", old, new))
    assert "\n" not in str(caught.value)
    assert str(scenes) in str(caught.value)


def test_an_object_that_cannot_move(scenes: Path) -> None:
    changed(scenes / "cube.xml", '<freejoint name="cube"/>', "")
    path = changed(scenes / "cube.yaml", "forces:\n  cube:", "forces:\n  other:")
    changed(
        scenes / "cube.xml",
        "</worldbody>",
        '<body name="other"><joint name="other"/><geom size=".1"/></body></worldbody>',
    )
    with pytest.raises(InputError, match=r"body 'cube' of cube.xml has no joint.*<freejoint/>"):
        load_scene(path)


def test_an_mjcf_that_is_none(scenes: Path) -> None:
    (scenes / "cube.xml").write_text("<mujoco><worldbody><body></mujoco>")
    with pytest.raises(InputError, match=r"cube.xml: no MJCF that MuJoCo takes"):
        load_scene(scenes / "cube.yaml")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (table(qw=2.0), r"orientation: reading 1 is a quaternion of length 2"),
        (table().replace("qx", "rx"), r"orientation: no column 'qx'; there are x, y, z, qw, rx"),
        (table(rows=2), r"position: has 2 readings, too few"),
        ("", r"is empty"),
        (table() + "\n1,2,3", r"line 22: has 3 numbers, the first line 7 names"),
        (table() + "\n1,2,3,a,0,0,0", r"line 22: holds what is no number"),
    ],
)
def test_a_csv_file_that_is_no_recording(scenes: Path, text: str, said: str) -> None:
    (scenes / "r.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_track(scenes / "r.csv", load_scene(scenes / "cube.yaml"))


def test_time_that_runs_backwards(scenes: Path) -> None:
    rows = table().split("\n")
    times = np.arange(20) * 0.01
    times[7] = 0.03
    told = [rows[0] + ",time_s", *(f"{r},{t}" for r, t in zip(rows[1:], times, strict=True))]
    (scenes / "r.csv").write_text("\n".join(told))
    with pytest.raises(InputError, match=r"time_s: runs backwards or stands still at line 9"):
        read_track(scenes / "r.csv", load_scene(scenes / "cube.yaml"))


def test_a_recording_that_is_given_twice(scenes: Path) -> None:
    (scenes / "r.csv").write_text(table())
    loaded = load_scene(scenes / "cube.yaml")
    with pytest.raises(InputError, match=r"given twice"):
        read_tracks([scenes / "r.csv", scenes / "r.csv"], loaded)
    with pytest.raises(InputError, match=r"no such recording"):
        read_tracks([scenes / "none.csv"], loaded)


def test_a_scene_that_is_written_is_the_same(scenes: Path) -> None:
    loaded = load_scene(scenes / "elbow.yaml")
    values = tuple(
        v.but(value=5e3 if v.effect in ("contact_stiffness", "contact_damping") else 0.25)
        for v in loaded.scene.values
    )
    (scenes / "deeper").mkdir()
    save_scene(loaded, values, scenes / "deeper" / "new.yaml")
    again = load_scene(scenes / "deeper" / "new.yaml")
    assert again.scene.values == values
    assert again.scene.sensors == loaded.scene.sensors
    assert again.mjcf.resolve() == loaded.mjcf.resolve()


@pytest.mark.parametrize("timed", [True, False])
def test_columns_of_a_csv_in_their_units_at_their_times(tmp_path: Path, timed: bool) -> None:
    """Columns in another order than the sensors' own, each sensor in a unit of its own."""
    (tmp_path / "wand.xml").write_text(WAND)
    columns = {
        "turn": (["deg"], np.pi / 180.0), "force": (["fz", "fx", "fy"], 1000.0),
        "torque": (["ty", "tz", "tx"], 1.0), "rate": (["gx", "gy", "gz"], 0.25),
        "acceleration": (["az", "ay", "ax"], 9.81), "place": (["py", "px", "pz"], 0.001),
    }  # fmt: skip
    scene = WAND_SCENE.replace("name: wand\n", "name: wand\nrate_hz: 40.0\n")
    for name, (own, unit) in columns.items():
        scene = re.sub(
            rf"  {name}: {{topic: [^,]*,", f"  {name}: {{columns: {own}, unit: {unit!r},", scene
        )
    scene = re.sub(r"pose: {topic: [^,]*,", "pose: {columns: [qw, qx, qy, qz],", scene)
    scene = re.sub(r"drive: {.*}", "drive: {column: volts, unit: 0.2}", scene)
    (tmp_path / "wand.yaml").write_text(scene)
    names = ["volts", *sorted(c for own, _ in columns.values() for c in own)]
    table = 0.5 + np.random.default_rng(1).normal(size=(12, len(names)))
    time = 7.5 + np.cumsum(np.linspace(0.01, 0.05, 12))
    turns = Rotation.from_rotvec(np.outer(np.linspace(0.1, 2.9, 12), [0.6, 0.0, -0.8]))
    q = turns.as_quat(scalar_first=True) * np.array([1.0, -1.0] * 6)[:, None]
    heads = [*(["time_s"] if timed else []), *names, "qx", "qz", "qw", "qy"]
    rows = np.column_stack([*([time] if timed else []), table, q[:, [1, 3, 0, 2]]])
    lines = [",".join(heads), *(",".join(f"{x:.15g}" for x in row) for row in rows)]
    (tmp_path / "run.csv").write_text("\n".join(lines))
    track = read_track(tmp_path / "run.csv", load_scene(tmp_path / "wand.yaml"))
    at = time - time[0] if timed else np.arange(12) / 40.0
    for name, (own, unit) in columns.items():
        wanted = unit * table[:, [names.index(c) for c in own]]
        np.testing.assert_allclose(track.sensors[name].values, wanted, rtol=1e-12)
        np.testing.assert_allclose(track.sensors[name].time_s, at, atol=1e-12)
    np.testing.assert_allclose(track.controls["drive"].values, 0.2 * table[:, :1])
    pose = track.sensors["pose"].values
    np.testing.assert_allclose(np.abs(np.sum(pose * q, axis=1)), 1.0)
    assert (np.sum(pose[1:] * pose[:-1], axis=1) > 0.0).all()  # no jump of sign


# ---- bags ----------------------------------------------------------------------------------

STORE = get_typestore(Stores.ROS2_JAZZY)
WAND = """<mujoco><option timestep="0.005"/><worldbody>
<geom name="floor" type="plane" size="1 1 .1" pos="0 0 -5"/>
<body name="arm"><joint name="turn" axis="0 0 1"/><geom type="box" size=".2 .02 .02" mass="1"/>
 <site name="wrist" pos=".2 0 0"/>
 <body name="hand" pos=".2 0 0"><geom type="box" pos=".05 0 0" size=".05 .02 .02" mass=".5"/>
 <site name="f" pos="0 0 0"/></body></body>
<body name="thing" pos="1 0 0"><freejoint name="thing"/><geom type="box" size=".1 .1 .1" mass="1"/>
</body></worldbody>
<actuator><motor name="drive" joint="turn"/></actuator>
<sensor><jointpos name="turn" joint="turn"/><force name="force" site="f"/>
<torque name="torque" site="f"/><gyro name="rate" site="wrist"/>
<accelerometer name="acceleration" site="wrist"/>
<framepos name="place" objtype="xbody" objname="thing"/>
<framequat name="pose" objtype="xbody" objname="thing"/></sensor></mujoco>"""
WAND_SCENE = """pneu_scene: 1
name: wand
mjcf: wand.xml
knots: {step_s: 0.005}
sensors:
  turn: {topic: /joint_states, norm: {std: 0.0001}}
  force: {topic: /wrench, norm: {std: 0.05}}
  torque: {topic: /wrench, norm: {std: 0.05}}
  rate: {topic: /imu, norm: {std: 0.01}}
  acceleration: {topic: /imu, norm: {std: 0.1}}
  place: {topic: /mocap/thing, norm: {std: 0.001}}
  pose: {topic: /mocap/thing, norm: {std: 0.01}}
controls:
  drive: {topic: /joint_states, joint: turn}
forces:
  turn: {along: {std: 0.01}}
  thing: {translation: {std: 0.1}, rotation: {std: 0.01}}
"""


def write_wand(folder: Path, turned: Rotation | None = None, backwards: bool = False) -> Path:
    """A driven arm and a thing that falls, at the rates that such sensors have."""
    model = mujoco.MjModel.from_xml_string(WAND)
    model.opt.timestep = 0.0005
    data = mujoco.MjData(model)
    (folder / "wand.xml").write_text(WAND)
    (folder / "wand.yaml").write_text(WAND_SCENE)
    types = STORE.types
    time_of, head_of = types["builtin_interfaces/msg/Time"], types["std_msgs/msg/Header"]
    vector = types["geometry_msgs/msg/Vector3"]
    point, quaternion = types["geometry_msgs/msg/Point"], types["geometry_msgs/msg/Quaternion"]
    turned = turned or Rotation.identity()

    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {
            "/joint_states": "sensor_msgs/msg/JointState",
            "/wrench": "geometry_msgs/msg/WrenchStamped",
            "/imu": "sensor_msgs/msg/Imu",
            "/mocap/thing": "geometry_msgs/msg/PoseStamped",
        }
        topics = {t: writer.add_connection(t, kind, typestore=STORE) for t, kind in kinds.items()}

        def put(topic: str, ns: int, head: object, *parts: object) -> None:
            message = types[kinds[topic]](head, *parts)
            writer.write(topics[topic], ns, STORE.serialize_cdr(message, kinds[topic]))

        for i in range(2400):
            t = i * 0.0005
            u = 0.6 * np.sin(2.0 * np.pi * 1.5 * t)
            data.ctrl[0] = u
            mujoco.mj_forward(model, data)
            read = data.sensordata
            stamp = t - 0.4 if backwards and t > 0.7 else t
            ns = 1_700_000_000_000_000_000 + round(stamp * 1e9)
            head = head_of(time_of(ns // 10**9, ns % 10**9), "world")
            if i % 8 == 0:
                empty = np.zeros(0)
                put("/joint_states", ns, head, ["other", "turn"], np.array([0.0, read[0]]),
                    empty, np.array([0.0, u]))  # fmt: skip
            if i % 2 == 0:
                wrench = types["geometry_msgs/msg/Wrench"](
                    vector(*turned.apply(read[1:4])), vector(*turned.apply(read[4:7]))
                )
                put("/wrench", ns, head, wrench)
            nine = np.zeros(9)
            put("/imu", ns, head, quaternion(0.0, 0.0, 0.0, 1.0), nine, vector(*read[7:10]),
                nine, vector(*read[10:13]), nine)  # fmt: skip
            if i % 12 == 0:
                w, x, y, z = read[16:20]
                pose = types["geometry_msgs/msg/Pose"](point(*read[13:16]), quaternion(x, y, z, w))
                put("/mocap/thing", ns, head, pose)
            mujoco.mj_step(model, data)
    return folder / "bag"


def test_a_bag_of_joints_wrenches_inertial_units_and_poses(tmp_path: Path) -> None:
    bag = write_wand(tmp_path)
    loaded = load_scene(tmp_path / "wand.yaml")
    track = read_track(bag, loaded)
    rates = {name: round(1.0 / s.every_s) for name, s in track.sensors.items()}
    assert rates == {
        "turn": 250, "force": 1000, "torque": 1000, "rate": 2000, "acceleration": 2000,
        "place": 167, "pose": 167,
    }  # fmt: skip
    found = fit_scene(loaded, [track], physics=Physics(1))
    chain = found.chains[0]
    setup = loaded.setup(found.values)
    said = chain.outputs(found.q[0], setup.spec.compile(), setup, Physics(1))
    for channel in chain.channels:
        off = chain.misreadings(channel, said, setup)
        sigma = 1.0 / np.sqrt(2.0 * channel.norm.weight)
        assert np.sqrt(np.mean(off**2)) < sigma, channel.name


def test_units_of_a_bag(tmp_path: Path) -> None:
    """Each sensor and control is scaled by its own unit; orientations by none."""
    bag = write_wand(tmp_path)
    plain = read_track(bag, load_scene(tmp_path / "wand.yaml"))
    units = {"turn": 0.0174, "force": 1000.0, "torque": 3.0, "rate": 0.25, "acceleration": 9.81,
             "place": 0.001, "drive": 0.2}  # fmt: skip
    text = WAND_SCENE
    for name, unit in units.items():
        text = text.replace(f"  {name}: {{topic", f"  {name}: {{unit: {unit}, topic")
    (tmp_path / "other.yaml").write_text(text)
    found = read_track(bag, load_scene(tmp_path / "other.yaml"))
    for name, series in {**plain.sensors, **plain.controls}.items():
        own = {**found.sensors, **found.controls}[name]
        np.testing.assert_allclose(own.values, units.get(name, 1.0) * series.values, rtol=1e-12)
        np.testing.assert_array_equal(own.time_s, series.time_s)


def test_a_force_in_another_frame_is_named_with_its_turn(tmp_path: Path) -> None:
    bag = write_wand(tmp_path, Rotation.from_rotvec([0.0, 0.0, np.pi / 2]))
    loaded = load_scene(tmp_path / "wand.yaml")
    with pytest.raises(InputError, match=r"sensor 'force' tells its vectors turned by (89|90|91)°"):
        fit_scene(loaded, [read_track(bag, loaded)], physics=Physics(1))


def test_a_bag_that_lacks_what_the_scene_names(tmp_path: Path) -> None:
    bag = write_wand(tmp_path)
    scene = tmp_path / "wand.yaml"
    text = scene.read_text()
    for old, new, said in (
        ("topic: /wrench", "topic: /wrench2", r"no topic '/wrench2' in the bag \(nearest: /wrench"),
        ("joint: turn}", "joint: elbow}", r"no joint 'elbow', it has 'other', 'turn'"),
        ("force: {topic: /wrench", "force: {topic: /imu", r"a sensor of type force reads is not"),
        ("rate: {topic", "rate: {field: speed, topic", r"field 'speed' is not there"),
        ("topic: /joint_states, norm", "columns: [a], norm", r"names no topic for it"),
    ):
        assert old in text
        scene.write_text(text.replace(old, new))
        with pytest.raises(InputError, match=said) as caught:
            read_track(bag, load_scene(scene))
        assert "\n" not in str(caught.value)


def test_a_bag_whose_stamps_run_backwards(tmp_path: Path) -> None:
    bag = write_wand(tmp_path, backwards=True)
    with pytest.raises(InputError, match=r"time runs backwards: message \d+ is stamped 0\.30"):
        read_track(bag, load_scene(tmp_path / "wand.yaml"))


# ---- the command line ----------------------------------------------------------------------


def thrown(folder: Path, count: int = 2) -> list[Path]:
    """Short flights of the cube that end on the floor, as CSV files."""
    model = mujoco.MjModel.from_xml_path(str(HOUSE / "scenes" / "cube.xml"))
    model.opt.timestep = 1.0 / 1480.0
    rng = np.random.default_rng(5)
    out = []
    for k in range(count):
        data = mujoco.MjData(model)
        data.qpos[:3] = 0.0, 0.0, 0.12
        data.qvel[:] = 0.8, 0.3, 0.0, *rng.normal(size=3)
        rows = []
        for i in range(500):
            if i % 10 == 0:
                rows.append([*(data.qpos[:3] / 0.0524), *data.qpos[3:]])
            mujoco.mj_step(model, data)
        path = folder / f"toss_{k}.csv"
        np.savetxt(path, np.array(rows), delimiter=",", header=HEAD, comments="", fmt="%.9g")
        out.append(path)
    return out


def invoked(*words: object) -> Result:
    commands = importlib.metadata.EntryPoint(
        "pneu_sysid", "pneu_sysid.commands:register", COMMANDS_GROUP
    )
    return CliRunner().invoke(build_app([commands]), [str(word) for word in words])


def pneu(*words: object) -> str:
    result = invoked(*words)
    assert result.exit_code == 0, result.output + result.stderr
    return str(result.stdout)


@pytest.mark.long
def test_a_scene_stands_where_a_rig_does(scenes: Path) -> None:
    files = thrown(scenes)
    fitted = scenes / "fitted.yaml"
    told = pneu("fit", *files, "--rig", scenes / "cube.yaml", "-o", fitted, "--json", scenes / "f")
    assert "contact_friction@all" in told
    result = result_of(json.loads((scenes / "f").read_text()))
    assert isinstance(result, SceneFitResult)
    assert result.parameters[0].effect == "contact_friction"
    told = pneu("compare", *files, "--rig", fitted, "--json", scenes / "c")
    assert "orientation" in told
    compared = result_of(json.loads((scenes / "c").read_text()))
    assert isinstance(compared, SceneCompareResult)
    # the recording is of this very model: foretold to a millimetre from a twentieth of a second
    assert compared.mean["position"] < 1e-3


def test_a_scene_refuses_effects_of_rigs(scenes: Path) -> None:
    files = thrown(scenes, 1)
    (scenes / "own.py").write_text("")
    words = ["compare", *files, "--rig", scenes / "cube.yaml", "--effects", scenes / "own.py"]
    result = invoked(*words)
    assert result.exit_code == 2
    assert re.fullmatch(r"pneu: [^\n]+ is a scene; --effects is of rigs\n", result.stderr)
