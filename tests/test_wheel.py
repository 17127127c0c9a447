# SPDX-License-Identifier: Apache-2.0
"""The product that users install: the wheel, alone in an environment, away from the checkout."""

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tarfile
import urllib.error
import urllib.request
import venv
import zipfile
from pathlib import Path

import pytest
from tests.coarse import coarsened
from tests.domains import own_domain_id
from tests.live_graph import wait_for
from tests.short_bags import shorten
from tests.test_packaging import PROJECT, tracked
from tests.wheels import Environment, build_distributions, outside, run

from pneu_sim.carried import EXAMPLES
from pneu_sim.rig import load_rig

pytestmark = pytest.mark.takes(40)

ROOT = Path(__file__).parent.parent
RIG, LEAK, HEALTHY = "rigs/rig_a_fitted.yaml", "data/bags/a_leak", "data/bags/a_healthy_2"


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """The source distribution, and the wheel made from it."""
    return build_distributions(tmp_path_factory.mktemp("built"))


@pytest.fixture(scope="module")
def pneu(built, tmp_path_factory):
    """An environment that holds the wheel and what it requires."""
    return Environment(tmp_path_factory.mktemp("environment"), built[1])


@pytest.fixture(scope="module")
def work(pneu, tmp_path_factory):
    """A folder outside the checkout with the examples that the wheel brings."""
    folder = tmp_path_factory.mktemp("work")
    said = pneu.run("init", "--example", "try", cwd=folder)
    assert f"pneu compare {LEAK}" in said
    return folder / "try"


def expected_files():
    """Return the files that an installation must have: packages, and the tree below share/pneu."""
    modules = {re.sub(r"^src/\w+/", "", n) for n in tracked("src/*/pneu_*/**")}
    data = {n for pattern in EXAMPLES for n in tracked(f":(glob){pattern}")}
    data |= set(tracked("msgs/msg", "msgs/srv", "msgs/action", "msgs/package.xml"))
    bringup = "ros_ws/src/pneu_bringup"
    inside = ("launch", "config", "layouts", "rigs", "scenes", "package.xml")
    data |= set(tracked(*(f"{bringup}/{one}" for one in inside)))
    # Links in the checkout; a wheel cannot hold links.
    data |= {f"{bringup}/rigs/lab.yaml", *(f"{bringup}/{n}" for n in tracked("scenes/phantom"))}
    return modules, {f"share/pneu/{name}" for name in data}


def test_wheel_and_source_distribution_hold_all_files_and_no_others(built):
    sdist, wheel = built
    modules, data = expected_files()
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    prefix = f"pneu-{PROJECT['version']}"
    assert {n for n in names if not n.startswith(prefix)} == modules
    assert {n.split(".data/data/")[1] for n in names if ".data/data/" in n} == data
    with tarfile.open(sdist) as archive:
        sources = {name.partition("/")[2] for name in archive.getnames()}
    assert {f"src/{name.partition('/')[0]}/{name}" for name in modules} <= sources
    assert {"pyproject.toml", "README.md", "LICENSE"} <= sources
    assert wheel.stat().st_size < 8e6


def test_uninstalling_leaves_alone_what_a_built_pneu_msgs_installs(built):
    """That puts its definitions and its marker where every ROS package does."""
    with zipfile.ZipFile(built[1]) as archive:
        names = [n.partition(".data/data/")[2] or n for n in archive.namelist()]
    theirs = ("share/pneu_msgs/", "share/ament_index/", "pneu_msgs/", "lib/", "include/")
    assert not [name for name in names if name.startswith(theirs)]


def test_every_command_of_the_readme_answers(pneu, tmp_path):
    """In one process: what is asked is whether each can be imported and described."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    wanted = set(re.findall(r"^\| `pneu ([\w-]+)", readme, flags=re.MULTILINE))
    code = """
import json, sys
from typer.testing import CliRunner
import typer.main
from pneu_common.cli import build_app
app = build_app()
said = {}
for name in typer.main.get_command(app).commands:
    result = CliRunner().invoke(app, [name, "--help"], prog_name="pneu")
    said[name] = [result.exit_code, result.stdout, result.stderr]
json.dump(said, sys.stdout)
"""
    said = json.loads(run(pneu.python, "-c", code, cwd=tmp_path))
    assert wanted <= set(said)
    for name, (status, out, error) in said.items():
        assert (status, error) == (0, ""), f"{name}: {error}"
        assert f"Usage: pneu {name}" in out
    listed = pneu.run("--help", cwd=tmp_path)
    assert all(f"  {name} " in listed for name in wanted)
    assert pneu.run("--version", cwd=tmp_path) == f"pneu {PROJECT['version']}\n"


def test_nothing_is_taken_from_the_checkout(pneu, tmp_path):
    code = (
        "import importlib, sys\n"
        "for name in sys.argv[1:]: print(importlib.import_module(name).__file__)"
    )
    names = [path.name for path in sorted((ROOT / "src").iterdir())]
    places = run(pneu.python, "-c", code, *names, cwd=tmp_path).split()
    assert len(places) == len(names)
    assert all(Path(place).is_relative_to(pneu.packages) for place in places)


def test_rig_files_are_written_checked_and_simulated(pneu, work):
    assert "pneu check bench.yaml" in pneu.run("init", "bench", "--kind", "tee", cwd=work)
    assert "left_chamber" in pneu.run("check", "bench.yaml", cwd=work)
    words = ("--rig", RIG, "--steps", "voltage=10:0.05,0:0.05", "-o", "run.csv")
    pneu.run("simulate", *words, cwd=work)
    header, *rows = (work / "run.csv").read_text().splitlines()
    assert "end" in header and len(rows) > 20
    assert "/taps/end" in pneu.run("bag", "info", LEAK, cwd=work)


def test_a_rig_is_calibrated(pneu, work):
    """On the lumped model, which takes seconds."""
    pneu.run("init", "lumped", "--kind", "line", cwd=work)
    with (work / "lumped.yaml").open("a") as rig:
        rig.write("model: thin_plate\n")
    words = ("--steps", "voltage=10:0.3,0:0.3,6:0.3", "--noise", "200", "--seed", "1", "-o", "made")
    pneu.run("simulate", "--rig", "lumped.yaml", *words, cwd=work)
    words = ("made", "--rig", "lumped.yaml", "-o", "fitted.yaml", "--iterations", "1")
    assert "wrote fitted.yaml" in pneu.run("fit", *words, cwd=work)
    assert "tube" in pneu.run("check", "fitted.yaml", cwd=work)


def test_recordings_are_compared_and_the_leak_is_learned(pneu, work):
    """On the beginnings of those that come along, with long cells; `make demo` has them whole."""
    coarsened(work / RIG, work / "rig_a_fitted.yaml")
    for bag in (HEALTHY, LEAK):
        shorten(next((work / bag).glob("*.mcap")), work / f"{Path(bag).name}.mcap", 2.0)
    words = ("a_healthy_2.mcap", "--rig", RIG, "--no-refine", "--json", "compare.json")
    pneu.run("compare", *words, cwd=work)
    assert json.loads((work / "compare.json").read_text())["pneu_version"] == PROJECT["version"]
    pneu.run("learn", "a_leak.mcap", "--rig", "rig_a_fitted.yaml", "-o", "learned", cwd=work)
    learned = json.loads((work / "learned" / "learn.json").read_text())
    assert learned["schema"] == "pneu.learn/1"
    before, after = learned["steps"]
    place, _, position_m = after["place"].partition(":")
    assert (after["added"], place) == ("leak", "tube")
    # The plant has a hole of 0.8 x 0.02 mm2 at the end of 2.5 m of tube.
    assert float(position_m) == pytest.approx(2.5, rel=0.2)
    assert after["strength"] == pytest.approx(0.8 * 0.02e-6, rel=0.2)
    assert after["held_out_times_noise"] < 0.2 * before["held_out_times_noise"]
    assert load_rig(work / "learned" / "step_1.yaml").effects[0].effect == "leak"


@contextlib.contextmanager
def started(*words, cwd, **environment):
    """Run a process until the block ends, then interrupt it; yields a function of its output."""
    log = cwd / f"{os.urandom(4).hex()}.log"
    with log.open("wb") as out:
        process = subprocess.Popen(
            [str(word) for word in words],
            cwd=cwd,
            env=outside(ROS_DOMAIN_ID=str(own_domain_id()), **environment),
            stdout=out,
            stderr=out,
            start_new_session=True,
        )
    try:
        yield lambda: log.read_text(errors="replace")
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) in (0, 130), log.read_text(errors="replace")
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert "Traceback" not in log.read_text(errors="replace")


def test_a_node_runs(pneu, work):
    words = ("run", "pneu_sim", "simulator", "--ros-args", "-p", f"rig:={RIG}")
    with started(pneu.folder / "bin/pneu", *words, cwd=work) as said:
        wait_for(lambda: "ready" in said())


def test_a_launch_file_runs(pneu, work):
    words = ("launch", "pneu_bringup", "rig.launch.yaml", "backend:=sim", "controller:=none")
    logs = {"ROS_LOG_DIR": str(work / "logs")}
    with started(pneu.folder / "bin/pneu", *words, cwd=work, **logs) as said:
        wait_for(lambda: "[simulator-" in said() and "ready" in said())


def test_the_workbench_answers(built, tmp_path_factory, work):
    folder = tmp_path_factory.mktemp("workbench")
    environment = Environment(folder, built[1], extras=("workbench",))
    words = ("workbench", work / LEAK, "--rig", work / RIG)
    # The address holds a token, which is exchanged for a cookie.
    browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor())

    def page():
        address = re.search(r"http://\S+", said())
        if address is None:
            return ""
        try:
            with browser.open(address[0], timeout=60.0) as answer:
                return answer.read().decode()
        except urllib.error.URLError as error:
            if isinstance(error.reason, ConnectionRefusedError):  # it is about to listen
                return ""
            raise

    with started(environment.folder / "bin/pneu", *words, cwd=folder, BROWSER="true") as said:
        wait_for(lambda: "a_leak" in page())


def test_the_workbench_names_the_extra_it_lacks(pneu, work):
    words = [str(pneu.folder / "bin/pneu"), "workbench"]
    done = subprocess.run(words, cwd=work, env=outside(), capture_output=True, text=True)
    assert done.returncode == 2 and "[workbench]" in done.stderr


@pytest.mark.long
def test_pip_installs_all_that_the_wheel_requires(built, tmp_path):
    """From the package index, into an environment that is really empty."""
    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env" / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", built[1], cwd=tmp_path)
    pneu = tmp_path / "env" / "bin" / "pneu"
    run(pneu, "init", "--example", "try", cwd=tmp_path)
    run(pneu, "learn", LEAK, "--rig", RIG, "-o", "learned", cwd=tmp_path / "try")
    assert '"added": "leak"' in (tmp_path / "try" / "learned" / "learn.json").read_text()
    run(sys.executable, "-m", "pip", "--python", python, "uninstall", "--yes", "pneu", cwd=tmp_path)
    assert not list((tmp_path / "env").rglob("pneu*"))
