# SPDX-License-Identifier: Apache-2.0
"""Build the wheel as a release does, and install it into environments that hold nothing else."""

import importlib.metadata
import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

from packaging.requirements import Requirement

ROOT = Path(__file__).parent.parent


KERNELS = ROOT / "src/pneu_sim/pneu_sim/__pycache__"
"""Compiled kernels of the checkout, which an installed copy of the same sources shares."""


def outside(**variables):
    """Return the environment of a user's shell: without what the tests have set for themselves."""
    ours = ("PYTEST", "PYTHONPATH", "PNEU_RCLPY")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    return {"NUMBA_CACHE_DIR": str(KERNELS), **kept, **variables}


def run(*words, cwd, timeout_s=300.0, **environment):
    """Run a command; return what it printed, and raise with all of it where it fails."""
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd,
        env=outside(**environment),
        capture_output=True,
        text=True,
        timeout=timeout_s,
    )
    assert done.returncode == 0, f"{words}: {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout


def build_distributions(folder):
    """Build the source distribution from the files under version control, and the wheel from it.

    Args:
        folder: Empty folder for the work and its results.

    Returns:
        The source distribution and the wheel.
    """
    checkout = folder / "checkout"
    words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    for name in run(*words, cwd=ROOT).split("\0"):
        if name and (ROOT / name).is_file():
            (checkout / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, checkout / name)
    code = "import setuptools.build_meta as b; print(b.build_{}({!r}))"
    source = run(sys.executable, "-c", code.format("sdist", str(folder)), cwd=checkout)
    sdist = folder / source.splitlines()[-1]
    shutil.unpack_archive(sdist, folder / "unpacked")
    (unpacked,) = (folder / "unpacked").iterdir()
    built = run(sys.executable, "-c", code.format("wheel", str(folder)), cwd=unpacked)
    return sdist, folder / built.splitlines()[-1]


class Environment:
    """A virtual environment with the wheel, and what its metadata requires, and nothing else.

    What it requires is linked from the environment that the tests run in: nothing is downloaded,
    and a dependency that the wheel does not declare is not there.
    """

    def __init__(self, folder, wheel, extras=()):
        """Create the environment and install.

        Args:
            folder: Where it goes.
            wheel: The wheel.
            extras: Extras of the wheel to have as well.
        """
        self.folder = folder
        venv.create(folder, with_pip=False, symlinks=os.name != "nt")
        self.python = folder / "bin" / "python"
        words = ("install", "--no-deps", "--no-index", "--no-compile", "--quiet", wheel)
        run(sys.executable, "-m", "pip", "--python", self.python, *words, cwd=folder)
        (package,) = folder.rglob("pneu_common/cli.py")
        self.packages = package.parent.parent
        for top in _required("pneu", extras):
            if not (self.packages / top.name).exists():
                (self.packages / top.name).symlink_to(top)

    def run(self, *words, cwd, **environment):
        """Run the `pneu` command of the environment; return what it printed.

        Args:
            *words: Words after `pneu`.
            cwd: Folder to run it in.
            **environment: Variables besides those of this process.
        """
        return run(self.folder / "bin" / "pneu", *words, cwd=cwd, **environment)


def _required(name, extras, seen=None):
    """Return what the distributions that one requires put beside it, with theirs."""
    seen = set() if seen is None else seen
    found = set()
    for text in importlib.metadata.requires(name) or []:
        wanted = Requirement(text)
        holds = not wanted.marker or any(
            wanted.marker.evaluate({"extra": extra}) for extra in ("", *extras)
        )
        key = (wanted.name.lower(), *sorted(wanted.extras))
        if not holds or key in seen:
            continue
        seen.add(key)
        if wanted.name != "pneu":
            distribution = importlib.metadata.distribution(wanted.name)
            tops = {file.parts[0] for file in distribution.files or [] if file.parts[0] != ".."}
            found |= {Path(distribution.locate_file(top)) for top in tops - {"__pycache__"}}
        found |= _required(wanted.name, wanted.extras, seen)
    return found
