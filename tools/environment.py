# SPDX-License-Identifier: Apache-2.0
"""Build the virtual environment that the Makefile's targets run in.

Needs nothing beyond the standard library. Creates the environment if it is missing or broken,
installs this repository into it in editable mode with the extras asked for, prints the names of the
packages, and marks the environment ready only once all of it is in place. The full output of the
installers is kept in `pip.log` inside the environment.
"""

import argparse
import importlib.util
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

OLDEST_PYTHON = (3, 11)
BUILT_WITH = {"clawpack": "gfortran"}
"""System packages without which pip cannot build one of Python's."""
UV = "uv>=0.9,<1"
SHARED = re.compile(r"[a-z-]*(url|links|constraint|host)")
"""Keys of pip's configuration that name sources of packages; uv has options of the same names."""
VARIABLES = {
    "cert": "SSL_CERT_FILE",
    "timeout": "UV_HTTP_TIMEOUT",
    "default-timeout": "UV_HTTP_TIMEOUT",
}
"""Environment variables of uv for other keys of pip's configuration."""
REPOSITORY = Path(__file__).resolve().parent.parent


class EnvironmentSetupError(Exception):
    """Something the user has to put right; its text is shown as it is."""


def main():
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("venv", type=Path, help="folder of the environment")
    parser.add_argument("--extra", help="extra of pyproject.toml to install as well")
    parser.add_argument(
        "--optional",
        action="store_true",
        help="install the extra's packages one by one and go on without those that fail",
    )
    options = parser.parse_args()
    return exit_status(build, options.venv, options.extra, options.optional)


def exit_status(build, *arguments):
    """Call a function that builds an environment, report what stops it, return the exit status."""
    try:
        build(*arguments)
    except EnvironmentSetupError as problem:
        print(f"environment: {problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nenvironment: interrupted", file=sys.stderr)
        return 130
    return 0


def build(venv, extra, optional):
    """Create the environment where needed, install into it, and leave its stamps."""
    started_s = time.monotonic()
    pip, log = prepare(venv)
    together = extra and not optional
    target = f"{REPOSITORY}[{extra}]" if together else str(REPOSITORY)
    what = f"pneu{f' with its {extra} tools' if together else ''}"
    install_all(pip, f"{what} into {venv}", ["--editable", target], log)
    if extra and optional:
        for requirement in extra_requirements(extra):
            print(f"installing {requirement}:", end="", flush=True)
            if not install(pip, [requirement], log):
                print(f"  {requirement} cannot be installed here and is left out (see {log})")
                tool = BUILT_WITH.get(re.match(r"[\w-]+", requirement)[0])
                if tool and shutil.which(tool) is None:
                    print(f"  it is built with {tool}, a system package: apt install {tool}")

    finish(venv, {"run", extra or "run"}, started_s)


def prepare(venv, *options):
    """Create the environment where needed; return the command that runs its pip, and the log.

    Args:
        venv: Folder of the environment.
        options: Options of `python -m venv`.
    """
    if sys.version_info < OLDEST_PYTHON:
        raise EnvironmentSetupError(
            "{} is Python {}.{}, and {}.{} or newer is needed; name another with "
            "`make PYTHON=python3.12 ...`".format(
                sys.executable, *sys.version_info[:2], *OLDEST_PYTHON
            )
        )
    pip = pip_of(venv, *options)
    log = venv / "pip.log"
    log.write_text("", encoding="utf-8")
    return pip, log


def finish(venv, names, started_s):
    """Mark an environment ready and report its size and the time taken.

    Args:
        venv: Folder of the environment.
        names: Names of the stamps.
        started_s: Steady time at which the build began.
    """
    for name in names:
        (venv / f".ready-{name}").touch()
    print(f"{venv} is ready after {time.monotonic() - started_s:.0f} s, {size_mb(venv):.0f} MB")


def pip_of(venv, *options):
    """Return the command that runs pip on the environment, creating it if it does not work."""
    python = venv / "bin" / "python"
    inside = [str(python), "-m", "pip"]
    outside = [sys.executable, "-m", "pip", "--python", str(python)]
    if works([str(python), "-c", ""]):
        if works([*inside, "--version"]):
            return inside
        if works([*outside, "--version"]):
            return outside
    make = [sys.executable, "-m", "venv", "--clear", *options, str(venv)]
    if importlib.util.find_spec("ensurepip") and works(make):
        return inside
    # Debian and Ubuntu ship python3 without ensurepip; a pip outside can still fill .venv.
    if works([*make, "--without-pip"]) and works([*outside, "--version"]):
        return outside
    if works([sys.executable, "-m", "virtualenv", "--clear", *options, str(venv)]):
        return inside
    raise EnvironmentSetupError(
        f"{sys.executable} can neither create a virtual environment with pip (module ensurepip) "
        "nor run a pip of its own; install its venv package (Debian and Ubuntu: apt install "
        "python3-venv) or name another interpreter with `make PYTHON=...`"
    )


def works(command):
    """Return whether a command runs and succeeds."""
    try:
        return subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def install_all(pip, what, requirements, log):
    """Install requirements that the environment cannot do without.

    Args:
        pip: Command that runs pip.
        what: What is installed, for the reader.
        requirements: Arguments of `pip install`.
        log: File that takes what pip prints.
    """
    print(f"installing {what}:", end="", flush=True)
    if not install(pip, requirements, log):
        raise EnvironmentSetupError(f"pip could not install {what}; the end of {log}:\n{tail(log)}")


def install(pip, requirements, log):
    """Install requirements, print the names of the packages, log the rest; return success.

    uv installs, with the sources that pip is configured for; pip does where uv is not available or
    fails. uv takes a third of the time.
    """
    # Python compiles what it imports and keeps it; all the rest is never needed.
    options = ["--no-compile", "--disable-pip-version-check", "--no-input"]
    commands = [([*pip, "install", *options, *requirements], {})]
    python = Path(pip[-1] if "--python" in pip else pip[0])
    uv = python.parent / "uv"
    got = uv.exists() or works([*pip, "install", *options, "--quiet", UV])
    if got and works([str(uv), "--version"]):
        words, variables = configured(pip)
        command = [str(uv), "pip", "install", "--python", str(python), *words, *requirements]
        commands.insert(0, (command, variables))
    return any(run(command, variables, log) for command, variables in commands)


def configured(pip):
    """Translate pip's configuration into options and environment variables of uv.

    Args:
        pip: Command that runs pip.
    """
    told = subprocess.run([*pip, "config", "list"], capture_output=True, text=True, check=False)
    words, variables = (
        ["--index-strategy", "unsafe-best-match"],
        {},
    )  # pip, too, takes the newest of all
    for line in told.stdout.splitlines():
        key, _, value = line.partition("=")
        key, values = key.rpartition(".")[2], value.strip().strip("'").replace("\\n", " ").split()
        if SHARED.fullmatch(key):
            words += [word for one in values for word in (f"--{key}", one)]
        elif key in VARIABLES and values:
            variables[VARIABLES[key]] = values[0]
        elif key == "no-index" and values and values[0].lower() in ("1", "true", "yes", "on"):
            words.append("--no-index")
    return words, variables


def run(command, variables, log):
    """Run an installer; return success.

    Args:
        command: Its command line.
        variables: Environment variables for it, unless they are set already.
        log: File that its output is appended to.
    """
    with log.open("a", encoding="utf-8") as record:
        process = subprocess.Popen(
            command,
            env={**variables, **os.environ},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        try:
            for line in process.stdout:
                record.write(line)
                found = re.match(r"(?:Collecting| \+) ([\w.-]+)", line)
                if found:
                    print(f" {found[1]}", end="", flush=True)
                elif line.startswith("Installing collected packages"):
                    print(" ... unpacking", end="", flush=True)
        finally:
            if process.poll() is None and sys.exc_info()[0] is not None:
                process.terminate()
            status = process.wait()
    print()
    return status == 0


def size_mb(folder):
    """Return what the files below a folder take on disk, in millions of bytes."""
    blocks = sum(path.lstat().st_blocks for path in folder.rglob("*"))
    return 512e-6 * blocks


def extra_requirements(extra):
    """Return the requirements that pyproject.toml lists under an extra."""
    import tomllib  # not there on the older interpreters that build() turns away

    with (REPOSITORY / "pyproject.toml").open("rb") as file:
        return tomllib.load(file)["project"]["optional-dependencies"][extra]


def tail(path, lines=15):
    """Return the last lines of a text file."""
    return "\n".join(path.read_text(encoding="utf-8").splitlines()[-lines:])


if __name__ == "__main__":
    sys.exit(main())
