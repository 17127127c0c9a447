# SPDX-License-Identifier: Apache-2.0
"""The version and the folder of files of an installation, of each kind that there is."""

import subprocess
import sys
from pathlib import Path

import pytest

from pneu_common import installed

pytestmark = pytest.mark.kernel_free

# Without `site` no distribution is found but those beside the packages.
PROGRAM = """
import sys, sysconfig
from pathlib import Path
sys.path.insert(0, sys.argv[1])
if len(sys.argv) > 2:
    sysconfig.get_path = lambda name, own=sysconfig.get_path: sys.argv[2] if name == "data" else own(name)
from pneu_common import installed
print(installed.version(), installed.own_tree(), sep="\\n")
"""  # noqa: E501


def found(packages: Path, data: Path) -> tuple[str, str]:
    """Version and folder that a copy of the module in a folder of packages tells."""
    folder = packages / "pneu_common"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "__init__.py").touch()
    text = Path(installed.__file__).read_text(encoding="utf-8")
    (folder / "installed.py").write_text(text, encoding="utf-8")
    command = [sys.executable, "-I", "-S", "-B", "-c", PROGRAM, str(packages), str(data)]
    version, tree = subprocess.check_output(command, text=True).splitlines()
    return version, tree


def brought(tree: Path) -> Path:
    """A folder with the file that tells a tree of ours."""
    (tree / "msgs").mkdir(parents=True)
    (tree / "msgs" / "package.xml").touch()
    return tree


def distribution(packages: Path, name: str, version: str, files: str = "") -> None:
    info = packages / f"{name}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (info / "RECORD").write_text(files)


def test_a_checkout(tmp_path: Path) -> None:
    packages = tmp_path / "house" / "src" / "pneu_common"
    assert found(packages, tmp_path) == ("(not installed)", "None")
    tree = brought(tmp_path / "house")
    brought(tmp_path / "share" / "pneu")  # of another installation
    assert found(packages, tmp_path) == ("(not installed)", str(tree))


def test_a_tree_that_is_no_checkout(tmp_path: Path) -> None:
    """Its folder is named otherwise."""
    brought(tmp_path / "house")
    packages = tmp_path / "house" / "lib" / "pneu_common"
    assert found(packages, tmp_path / "data") == ("(not installed)", "None")


def test_a_wheel(tmp_path: Path) -> None:
    """Where its record says, before the folders where it would lie by default."""
    packages = tmp_path / "lib" / "site"
    files = ["other/share/pneu/msgs/msg/A.msg", "share/pneu/msgs/package.xml.txt"]
    files.append("../../odd/share/pneu/msgs/package.xml")
    distribution(packages, "pneu", "1.2.3", "".join(f"{file},,\n" for file in files))
    distribution(packages, "pneu_sim", "4.5.6")
    tree = brought(tmp_path / "odd" / "share" / "pneu")
    brought(tmp_path / "data" / "share" / "pneu")
    assert found(packages, tmp_path / "data") == ("1.2.3", str(tree))


def test_a_wheel_whose_record_is_of_another_place(tmp_path: Path) -> None:
    """As `pip install --target` writes it: the files lie beside the packages."""
    packages = tmp_path / "target"
    distribution(packages, "pneu", "1.2.3", "../../share/pneu/msgs/package.xml,,\n")
    beside = brought(packages / "share" / "pneu")
    assert found(packages, tmp_path / "data") == ("1.2.3", str(beside))
    data = brought(tmp_path / "data" / "share" / "pneu")
    assert found(packages, tmp_path / "data") == ("1.2.3", str(data))


def test_packages_of_colcon(tmp_path: Path) -> None:
    packages = tmp_path / "install" / "python"
    distribution(packages, "pneu_sim", "4.5.6")
    assert found(packages, tmp_path / "data") == ("4.5.6", "None")


def test_this_installation() -> None:
    house = Path(__file__).parents[3]
    assert installed.own_tree() == house
    assert installed.own_tree() is installed.own_tree()
