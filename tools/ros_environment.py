# SPDX-License-Identifier: Apache-2.0
"""Build the virtual environment that runs the nodes on the genuine rclpy of ROS 2 Jazzy.

Where a ROS installation is sourced, the environment sees its packages, and pneu_msgs is the one
that colcon built there. Elsewhere rclpy comes from the ros-jazzy wheels, and the interface packages
that are in none of them are compiled. The wheels are never installed beside a sourced ROS: with the
libraries of both on LD_LIBRARY_PATH `import rclpy` fails most of the time.
"""

import argparse
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path

from environment import (
    REPOSITORY,
    EnvironmentSetupError,
    exit_status,
    extra_requirements,
    finish,
    install_all,
    prepare,
    works,
)

WHEELS = ["ros-jazzy-rclpy[fastrtps]>=7.1,<7.2", "ros-jazzy-common-interfaces"]
MSGS = REPOSITORY / "msgs"
NAME = "pneu_msgs"
DEFINITIONS = {
    "example_interfaces": REPOSITORY / "src/pneu_runtime/pneu_runtime/interfaces/share",
    "my_msgs": REPOSITORY / "examples",
}
"""Folder of the definitions of each interface package that the tests use and no wheel holds."""
TF_MESSAGE = "geometry_msgs/TransformStamped[] transforms\n"
NEEDED = ("pneu_msgs.msg", "example_interfaces.srv", "tf2_msgs.msg")


def main():
    """Run the command line and return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("venv", type=Path, help="folder of the environment")
    return exit_status(build, parser.parse_args().venv.resolve())


def build(venv):
    """Create the environment where needed, install into it, and leave its stamp."""
    started_s = time.monotonic()
    sourced = bool(os.environ.get("ROS_DISTRO") or os.environ.get("AMENT_PREFIX_PATH"))
    if sourced and not works([sys.executable, "-c", "import rclpy"]):
        raise EnvironmentSetupError(
            f"ROS is sourced, but {sys.executable} cannot import its rclpy; name the Python that"
            " it was built for with `make PYTHON=... ros-venv`, or use a shell without ROS"
        )
    if not sourced and not any(map(shutil.which, (os.environ.get("CXX", "c++"), "g++", "clang++"))):
        raise EnvironmentSetupError(
            "pneu_msgs has to be compiled, and there is no C++ compiler (c++, g++, clang++);"
            " install one (Debian and Ubuntu: apt install g++) or name it in the variable CXX"
        )
    pip, log = prepare(venv, *(["--system-site-packages"] if sourced else []))
    tools = [one for one in extra_requirements("dev") if one.startswith(("pytest", "hypothesis"))]
    tools += extra_requirements("robots")
    install_all(pip, f"pneu into {venv}", ["--editable", str(REPOSITORY), *tools], log)
    if sourced:
        for module in NEEDED:
            if not works([str(venv / "bin" / "python"), "-c", f"import {module}"]):
                raise EnvironmentSetupError(
                    f"ROS is sourced, but {module} cannot be imported; build ros_ws with colcon and"
                    " source its install/setup.bash (see ros_ws/README.md), and install the"
                    " packages ros-jazzy-example-interfaces and ros-jazzy-tf2-msgs"
                )
    else:
        install_interfaces(pip, venv, log)
    finish(venv, ["ros"], started_s)


def install_interfaces(pip, venv, log):
    """Install rclpy and the standard messages, and compile the other interface packages."""
    import tomllib  # not there on the older interpreters that prepare() turns away

    install_all(pip, "ROS 2 Jazzy", WHEELS, log)
    with (MSGS / "pyproject.toml").open("rb") as file:
        generators = tomllib.load(file)["build-system"]["requires"]
    install_all(pip, "the generators of interfaces", [*generators, "cmake", "ninja"], log)
    os.environ["PATH"] = f"{venv / 'bin'}{os.pathsep}{os.environ['PATH']}"  # for CMake to find them
    with tempfile.TemporaryDirectory(prefix="pneu-interfaces-") as scratch:
        packages = {NAME: MSGS}
        for name, folder in DEFINITIONS.items():
            packages[name] = like_pneu_msgs(Path(scratch), name)
            shutil.copytree(folder / name, packages[name], dirs_exist_ok=True)
        packages["tf2_msgs"] = like_pneu_msgs(Path(scratch), "tf2_msgs")
        (packages["tf2_msgs"] / "msg").mkdir()
        (packages["tf2_msgs"] / "msg" / "TFMessage.msg").write_text(TF_MESSAGE, encoding="utf-8")
        for name, folder in packages.items():
            install_all(pip, name, ["--no-build-isolation", str(folder)], log)


def like_pneu_msgs(scratch, name):
    """Return a new interface package without definitions, which is built as pneu_msgs is.

    Args:
        scratch: Folder that takes the folder of the package.
        name: Name of the package.
    """
    folder = scratch / name
    folder.mkdir()
    for file in ("CMakeLists.txt", "package.xml", "pyproject.toml"):
        text = (MSGS / file).read_text(encoding="utf-8").replace(NAME, name)
        text = text.replace(NAME.replace("_", "-"), name.replace("_", "-"))
        # pneu_msgs needs no messages of geometry, and frames do.
        text = text.replace("</depend>", "</depend><depend>geometry_msgs</depend>", 1)
        (folder / file).write_text(text, encoding="utf-8")
    return folder


if __name__ == "__main__":
    sys.exit(main())
