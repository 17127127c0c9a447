# SPDX-License-Identifier: Apache-2.0
"""Structure: every package, file of Python and test is known to all that has to know it."""

import fnmatch
import os
import re
import runpy
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import setuptools
from tests.packages import PACKAGES

sys.path.insert(0, str(Path(__file__).parent.parent / "tools"))
from version import versions

ROOT = Path(__file__).parent.parent
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = PYPROJECT["project"]


def tracked(*patterns: str) -> list[str]:
    """Return the files that are, or would be, under version control, relative to the top."""
    words = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z", *patterns]
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return sorted(name for name in listed.split("\0") if name and (ROOT / name).is_file())


@pytest.mark.parametrize("package", PACKAGES)
def test_every_folder_with_python_files_is_a_package(package):
    """`find_packages` leaves a folder without `__init__.py` out of the wheel, and says nothing."""
    folders = {Path(name).parent for name in tracked(f"src/{package}/{package}/**.py")}
    assert folders
    assert not [str(f) for f in folders if not (ROOT / f / "__init__.py").is_file()]


def test_every_package_is_known_to_all_tools():
    listed = {path.parent.name for path in (ROOT / "src").glob("*/package.xml")}
    assert listed == set(PACKAGES)
    tools = PYPROJECT["tool"]
    assert tools["setuptools"]["packages"]["find"]["where"] == [f"src/{p}" for p in PACKAGES]
    assert set(PACKAGES) <= set(tools["mypy"]["packages"])
    assert {f"src/{package}" for package in PACKAGES} <= set(tools["mypy"]["mypy_path"])
    for package in PACKAGES:
        assert any(fnmatch.fnmatch(f"src/{package}", one) for one in tools["ruff"]["src"])
    table = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert re.findall(r"^\| `(pneu_\w+)` \|", table, re.M) == list(PACKAGES)


def test_every_test_file_is_collected():
    paths = PYPROJECT["tool"]["pytest"]["ini_options"]["testpaths"]
    left_out = []
    for name in tracked("*.py"):
        text = (ROOT / name).read_text(encoding="utf-8")
        holds_tests = re.search(r"^def test_", text, re.MULTILINE)
        collected = Path(name).name.startswith("test_") and any(
            fnmatch.fnmatch(name, f"{path}/*") for path in paths
        )
        if holds_tests and not collected:
            left_out.append(name)
    assert not left_out
    for package in PACKAGES:
        assert list((ROOT / "src" / package / "test").glob("test_*.py")), package


def test_the_version_is_the_same_everywhere():
    found = versions()
    assert len(found) == len(PACKAGES) + 3  # pyproject.toml, pneu_msgs, pneu_bringup
    assert set(found.values()) == {PROJECT["version"]}


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_is_complete(package):
    manifest = ElementTree.parse(ROOT / "src" / package / "package.xml").getroot()
    assert (manifest.tag, manifest.get("format")) == ("package", "3")
    assert manifest.findtext("name") == package
    assert manifest.findtext("license") == PROJECT["license"]
    assert re.fullmatch(r"\S+@\S+\.\S+", manifest.find("maintainer").get("email"))
    assert manifest.findtext("export/build_type") == "ament_python"
    assert " ".join(manifest.findtext("description").split())


@pytest.mark.parametrize("package", PACKAGES)
def test_setup_py_installs_the_whole_package_under_the_names_of_pyproject(package, monkeypatch):
    """What colcon builds is what pip builds."""
    given = {}
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: given.update(arguments))
    monkeypatch.chdir(ROOT / "src" / package)
    runpy.run_path("setup.py")
    assert given["version"] == PROJECT["version"]
    assert given["license"] == PROJECT["license"]

    files = [Path(n).relative_to(f"src/{package}") for n in tracked(f"src/{package}/{package}/**")]
    modules, packages = {dotted(f.parent) for f in files if f.suffix == ".py"}, given["packages"]
    data = [pattern for one in given["package_data"].values() for pattern in one]
    as_data = {one for one in modules if one.startswith("pneu_runtime.embedded.")}
    assert set(packages) == modules - as_data
    for file in files:
        # A pattern without a package counts from every package around the file.
        names = [file.relative_to(f).as_posix() for f in file.parents if dotted(f) in packages]
        is_module = file.suffix == ".py" and dotted(file.parent) in packages
        assert is_module or any(matches(n, pattern) for n in names for pattern in data), file

    of_project = {"console_scripts": PROJECT["scripts"], **PROJECT["entry-points"]}
    nodes = of_project.pop("pneu.executables")
    expected = {
        group: sorted(f"{name} = {value}" for name, value in entries.items() if package in value)
        for group, entries in of_project.items()
    }
    # `ros2 run` finds the nodes of a package among its console scripts.
    expected["console_scripts"] += [
        f"{name.partition('.')[2]} = {value}"
        for name, value in nodes.items()
        if name.startswith(f"{package}.")
    ]
    found = {group: sorted(lines) for group, lines in given["entry_points"].items()}
    assert found == {group: sorted(lines) for group, lines in expected.items() if lines}


def dotted(folder: Path) -> str:
    """Return the name of the package in a folder."""
    return ".".join(folder.parts)


def matches(name: str, pattern: str) -> bool:
    """Return whether a path matches a pattern of package data, with `**` for any depth."""
    if pattern.startswith("**/"):
        return fnmatch.fnmatch(os.path.basename(name), pattern[3:])
    return fnmatch.fnmatch(name, pattern.replace("**/", "*"))
