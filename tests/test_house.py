# SPDX-License-Identifier: Apache-2.0
"""The repository's own rules: file headers, versions, dependencies, portability."""

import ast
import functools
import re
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from tests.packages import PACKAGES

pytestmark = pytest.mark.kernel_free

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
SPDX = "# SPDX-License-Identifier: Apache-2.0"

# What ROS brings on a machine that has it, and pneu_runtime on one that has not.
ROS_PACKAGES = {
    "action_msgs",
    "ament_index_python",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "lifecycle_msgs",
    "pneu_msgs",
    "rcl_interfaces",
    "rclpy",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
    "trajectory_msgs",
    "type_description_interfaces",
    "unique_identifier_msgs",
}
# Import names that differ from the name of the distribution that brings them.
DISTRIBUTION_OF = {
    "llvmlite": "numba",  # which requires one release of it
    "ruamel": "ruamel.yaml",
    "mpl_toolkits": "matplotlib",
    "stable_baselines3": "stable-baselines3",
}
# Wanted by training alone, and brought by extras; nothing that runs on a rig may need them.
TRAINING = ("learn", "tracking.py", "pushing.py", "robots.py", "task_env.py")
# Likewise MuJoCo, which only mechanisms that rigs name as MJCF need.
MECHANISMS = "mechanism"


def repository_files():
    """Files that are, or would be, under version control."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True).stdout
        paths = [ROOT / name for name in listed.decode().split("\0") if name]
    except (OSError, subprocess.CalledProcessError):  # an unpacked archive
        hidden = re.compile(r"/(\.(venv|git|\w+_cache)|__pycache__|build|dist|out|\S+\.egg-info)/")
        paths = [path for path in ROOT.rglob("*") if not hidden.search(f"/{path}/")]
    return sorted(path for path in paths if path.is_file())


FILES = repository_files()
PYTHON_FILES = [path for path in FILES if path.suffix == ".py"]


def relative(path):
    return str(path.relative_to(ROOT))


def test_the_repository_is_found():
    assert ROOT / "pyproject.toml" in FILES
    assert len(PYTHON_FILES) > 5


def test_sources_start_with_licence_and_say_what_they_are_about():
    wrong = []
    for path in PYTHON_FILES:
        text = path.read_text(encoding="utf-8")
        lines = [line for line in text.splitlines()[:2] if not line.startswith("#!")]
        if not lines or lines[0] != SPDX:
            wrong.append(f"first line of {relative(path)} is not '{SPDX}'")
        if not ast.get_docstring(ast.parse(text)):
            wrong.append(f"{relative(path)} has no module docstring")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("name", ["Makefile", ".ci/run"])
def test_script_names_its_licence(name):
    assert SPDX in (ROOT / name).read_text(encoding="utf-8").splitlines()[:2]


@pytest.mark.parametrize("package", PACKAGES)
def test_ament_marker_is_there(package):
    assert (ROOT / "src" / package / "resource" / package).is_file()
    assert (ROOT / "src" / package / package / "py.typed").is_file()


OTHERS = ("figures.py", "pneu_workbench")
"""What does without the rest of an extra, and the package that is one."""


@pytest.mark.parametrize("package", PACKAGES)
def test_what_the_package_imports_is_declared(package):
    declared = {distribution(requirement) for requirement in PROJECT["dependencies"]}
    extras = PROJECT["optional-dependencies"]
    of_extras = declared | {
        distribution(one)
        for name in ("figures", "learn", "study", "cluster", "robots", "workbench")
        for one in extras[name]
    }
    undeclared = {
        f"{relative(path)} imports {module}"
        for path in (ROOT / "src" / package / package).rglob("*.py")
        for module in imported_modules(path)
        if module not in sys.stdlib_module_names
        and module not in PACKAGES
        and module not in ROS_PACKAGES
        and DISTRIBUTION_OF.get(module, module)
        not in (of_extras if {*TRAINING, MECHANISMS, *OTHERS} & set(path.parts) else declared)
    }
    assert not undeclared, "\n".join(sorted(undeclared))


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_names_what_the_package_imports(package):
    """Each as an exec_depend, or in the comment on what comes by pip; and none is idle."""
    path = ROOT / "src" / package / "package.xml"
    depends = {d.text for d in ElementTree.parse(path).getroot().iter("exec_depend")}
    comments = re.findall(r"come by pip, see pyproject.toml: ([\w, ]+)\.", path.read_text())
    by_pip = {name for comment in comments for name in comment.split(", ")}
    imported = {
        DISTRIBUTION_OF.get(module, module).replace("stable-baselines3", "stable_baselines3")
        for source in (ROOT / "src" / package / package).rglob("*.py")
        for module in imported_modules(source)
        if module not in sys.stdlib_module_names and module != package
    }
    listed = {name.removeprefix("python3-") for name in depends} | by_pip
    assert imported == listed


@pytest.mark.parametrize("package", PACKAGES)
def test_numerics_import_without_ros(package):
    """Only nodes, and the runtime that stands in for ROS, may import what ROS brings."""
    of_ros = {
        f"{relative(path)} imports {module}"
        for path in (ROOT / "src" / package / package).rglob("*.py")
        if "nodes" not in path.parts and package != "pneu_runtime"
        for module in imported_at_the_top(path)
        if module in ROS_PACKAGES
    }
    assert not of_ros, "\n".join(sorted(of_ros))


def test_what_runs_on_a_rig_does_not_import_the_training():
    offenders = {
        f"{relative(path)} imports {module}"
        for path in (ROOT / "src/pneu_policy/pneu_policy").rglob("*.py")
        if not set(TRAINING) & set(path.parts)
        for module in ("torch", "gymnasium", "stable_baselines3", "ray")
        if module in imported_modules(path)
    }
    assert not offenders


@pytest.mark.parametrize("package", PACKAGES)
def test_mujoco_is_imported_only_to_build_a_mechanism(package):
    """Within functions of `pneu_sim.mechanism`: whoever has no MJCF needs no MuJoCo."""
    root = ROOT / "src" / package / package
    offenders = [
        relative(path)
        for path in root.rglob("*.py")
        if "mujoco" in (imported_at_the_top if MECHANISMS in path.parts else imported_modules)(path)
    ]
    assert not offenders


def test_the_simulator_does_not_import_the_identification():
    offenders = [
        relative(path)
        for path in (ROOT / "src/pneu_sim/pneu_sim").rglob("*.py")
        if "pneu_sysid" in imported_modules(path)
    ]
    assert not offenders


def distribution(requirement):
    return re.match(r"[\w.-]+", requirement)[0].lower()


def imported_modules(path):
    """Top-level names of all absolute imports of a file, also those inside functions."""
    return imports_of(path)[0]


def imported_at_the_top(path):
    """Top-level names of the imports that run when a file is imported."""
    return imports_of(path)[1]


@functools.cache
def imports_of(path):
    """Top-level names of the absolute imports of a file: all of them, and those at its top."""
    tree = ast.parse(path.read_text(encoding="utf-8"))

    def names(nodes):
        for node in nodes:
            if isinstance(node, ast.Import):
                yield from (alias.name.partition(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                yield node.module.partition(".")[0]

    return frozenset(names(ast.walk(tree))), frozenset(names(tree.body))


# Written in pieces so that this file does not contain what it looks for.
MACHINE_PATHS = re.compile(
    r"(?<![\w.])/(?:" + "|".join(["work", "root", "home/" + r"\w+", "opt/" + "pypi"]) + r")/"
    r"|\.\./" + "shared" + r"\b|--(?:extra-)?index" + "-url|--find" + "-links"
)


def test_no_file_names_a_path_of_one_machine():
    found = []
    for path in FILES:
        content = path.read_bytes()
        if b"\0" in content[:8192]:
            continue  # a recording or an image
        for number, line in enumerate(content.decode(errors="replace").splitlines(), start=1):
            if MACHINE_PATHS.search(line):
                found.append(f"{relative(path)}:{number}: {line.strip()[:100]}")
    assert not found, "\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("line", "is_one"),
    [
        ("open('/" + "work/main/x')", True),
        ("see .." + "/shared/data", True),
        ("pip install --index" + "-url https://x", True),
        ("docs/work/notes.md", False),
        ("$(HOME)/.cache", False),
        ("/home is where the heart is", False),
    ],
)
def test_machine_paths_are_recognised(line, is_one):
    assert bool(MACHINE_PATHS.search(line)) == is_one


def test_nothing_of_ours_creates_a_guard_condition():
    """The EventsExecutor of rclpy cannot wait on one; `ExecutorCallback` works in all executors."""
    embedded = ROOT / "src/pneu_runtime/pneu_runtime/embedded/rclpy"
    words = re.compile(r"create_guard_condition|GuardCondition")
    assert any(words.search(path.read_text(encoding="utf-8")) for path in embedded.rglob("*.py"))
    found = [
        relative(path)
        for package in PACKAGES
        for path in (ROOT / "src" / package / package).rglob("*.py")
        if embedded not in path.parents and words.search(path.read_text(encoding="utf-8"))
    ]
    assert not found


LONGEST_LINES, MOST_ARGUMENTS = 120, 15


def test_no_function_of_the_simulator_is_too_long_or_takes_too_much():
    """The physics can be read aloud: no function fills more than two pages, or takes a parade."""
    unreadable = []
    for path in sorted((ROOT / "src" / "pneu_sim" / "pneu_sim").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                continue
            given = node.args
            arguments = len([*given.posonlyargs, *given.args, *given.kwonlyargs])
            lines = node.end_lineno - node.lineno + 1
            if lines > LONGEST_LINES or arguments > MOST_ARGUMENTS:
                unreadable.append(f"{path.name}: {node.name}: {lines} lines, {arguments} arguments")
    assert not unreadable
