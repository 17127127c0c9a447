# SPDX-License-Identifier: Apache-2.0
"""What may import what: each package only those below it, and no file, by whatever way, itself."""

import ast
import functools
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from tests.packages import PACKAGES

SOURCES = Path(__file__).parent.parent / "src"


def modules() -> dict[str, Path]:
    """Files of the packages by module name; without the stand-in for rclpy, built as that is."""
    found = {}
    for package in PACKAGES:
        root = SOURCES / package
        for path in (root / package).rglob("*.py"):
            parts = path.relative_to(root).with_suffix("").parts
            if "embedded" not in parts:
                found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(tree: ast.AST, known: dict[str, Path]) -> Iterator[str]:
    """Modules that a file imports: at its top, within functions, or for type checkers alone."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in known else node.module


def graph(files: dict[str, Path]) -> dict[str, set[str]]:
    """What each module needs: also the packages around what it imports, unless it is within."""
    needs: dict[str, set[str]] = {}
    for name, path in files.items():
        needs[name] = set()
        for wanted in imported(ast.parse(path.read_text(encoding="utf-8")), files):
            parts = wanted.split(".")
            around = {".".join(parts[:n]) for n in range(1, len(parts) + 1)}
            needs[name] |= {
                m for m in around & files.keys() if m != name and not name.startswith(m + ".")
            }
    return needs


@functools.cache
def needs_of_all() -> dict[str, set[str]]:
    """What each module needs; not at import, since every worker of the tests imports this."""
    return graph(modules())


def test_every_package_is_one_of_the_layers():
    assert {path.name for path in SOURCES.iterdir()} == set(PACKAGES)


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_what_lies_below_it(package):
    allowed = PACKAGES[: PACKAGES.index(package) + 1]
    upward = {
        f"{name} imports {wanted}"
        for name, needs in needs_of_all().items()
        if name.partition(".")[0] == package
        for wanted in needs
        if wanted.partition(".")[0] not in allowed
    }
    assert not upward, "\n".join(sorted(upward))


def test_no_imports_go_in_a_circle():
    try:
        TopologicalSorter(needs_of_all()).prepare()
    except CycleError as error:
        pytest.fail(" -> ".join(reversed(error.args[1])))


def test_a_circle_would_be_found(tmp_path):
    """Also one that is closed within a function, or for type checkers alone."""
    for name, text in {
        "a": "import b",
        "b": "def f():\n    from c import g",
        "c": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import a",
    }.items():
        (tmp_path / f"{name}.py").write_text(text)
    needs = graph({path.stem: path for path in tmp_path.glob("*.py")})
    assert needs == {"a": {"b"}, "b": {"c"}, "c": {"a"}}
    with pytest.raises(CycleError):
        TopologicalSorter(needs).prepare()
