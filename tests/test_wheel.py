# SPDX-License-Identifier: Apache-2.0
"""A wheel is enough: built and installed away from the checkout, it has what the story needs."""

import os
import shutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

from pneu_sim.carried import example_files

ROOT = Path(__file__).parent.parent
PARTS = ("pyproject.toml", "README.md", "LICENSE", "src", "msgs", "rigs", "data/bags")
BRINGUP = "ros_ws/src/pneu_bringup"


def run(*words, cwd, **environment):
    """Runs Python; returns what it printed, and shows all of it where it failed."""
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built from a copy, so that the checkout is left without traces of it."""
    copy = tmp_path_factory.mktemp("checkout")
    for part in (*PARTS, BRINGUP):
        if (ROOT / part).is_file():
            shutil.copyfile(ROOT / part, copy / part)
        else:
            made = shutil.ignore_patterns("__pycache__", "*.egg-info", "test")
            shutil.copytree(ROOT / part, copy / part, ignore=made)
    code = "import setuptools.build_meta as b; print(b.build_wheel('out'))"
    (copy / "out").mkdir()
    name = run("-c", code, cwd=copy).splitlines()[-1]
    return copy / "out" / name


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The folder of packages of an environment that holds nothing but the wheel.

    An environment of its own, and not `pip install --prefix`: that would take the Pneu that the
    tests run in out of its environment.
    """
    environment = tmp_path_factory.mktemp("installed")
    venv.create(environment, with_pip=False, symlinks=os.name != "nt")
    python = environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    words = ("install", "--no-deps", "--no-index", "--no-compile", wheel)
    run("-m", "pip", "--python", python, *words, cwd=environment, PYTHONPATH="")
    (package,) = environment.rglob("pneu_sim/init.py")
    return package.parent.parent


@pytest.mark.long
def test_it_carries_the_examples_and_the_templates(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    _, examples = example_files()
    prefix = next(n for n in names if n.endswith("share/pneu/LICENSE")).removesuffix("LICENSE")
    assert {n.removeprefix(prefix) for n in names if n.startswith(prefix)} == set(examples)
    assert "data/bags/a_leak/a_leak.mcap" in examples
    templates = {f"pneu_sim/rig/templates/{kind}.yaml" for kind in ("cylinder", "line", "tee")}
    assert templates == {name for name in names if "/templates/" in name and "pneu_sim" in name}
    assert wheel.stat().st_size < 8e6


@pytest.mark.long
def test_a_user_without_a_checkout_can_begin(installed, tmp_path):
    def pneu(*words):
        return run("-m", "pneu_common.cli", *words, cwd=tmp_path, PYTHONPATH=str(installed))

    code = "import pneu_sim, pneu_sysid; print(pneu_sim.__file__, pneu_sysid.__file__)"
    places = run("-c", code, cwd=tmp_path, PYTHONPATH=str(installed)).split()
    assert all(Path(place).is_relative_to(installed) for place in places)

    assert "pneu check bench.yaml" in pneu("init", "bench", "--kind", "tee")
    assert "left_chamber" in pneu("check", "bench.yaml")
    assert "pneu compare data/bags/a_leak" in pneu("init", "--example", "try")
    folder, examples = example_files()
    for name in examples:
        assert (tmp_path / "try" / name).read_bytes() == (folder / name).read_bytes()
    assert "supply_line" in pneu("check", "try/rigs/rig_a_fitted.yaml")
    assert "/taps/end" in pneu("bag", "info", "try/data/bags/a_leak")
