# SPDX-License-Identifier: Apache-2.0
"""Files of the chosen folder: what is offered, and that nothing else is reached."""

from pathlib import Path

import pytest

from pneu_common.errors import InputError
from pneu_workbench.files import LARGEST, Folder, dropped_name


@pytest.fixture
def root(tmp_path: Path) -> Path:
    root = tmp_path / "root"
    for name in ("bags/one/metadata.yaml", "bags/one/one_0.mcap", "lone.mcap", "table.CSV"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("x: 1\n")
    (root / "rig.yaml").write_text("# a rig\n\npneu_rig: 1\nname: a\n")
    (root / "scene.yml").write_text("pneu_scene: 1\n")
    (root / "other.yaml").write_text("something: else\n")
    (root / ".hidden").mkdir()
    (root / ".hidden" / "rig.yaml").write_text("pneu_rig: 1\n")
    (tmp_path / "secret.mcap").write_text("secret")
    (root / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    (root / "out").symlink_to(tmp_path)
    return root


def test_recordings_and_rigs_are_found(root: Path) -> None:
    folder = Folder(root)
    assert folder.recordings() == ["bags/one", "lone.mcap", "table.CSV"]
    assert folder.rigs() == ["rig.yaml"]
    assert folder.path("bags/one") == root / "bags" / "one"


@pytest.mark.parametrize(
    "name",
    [
        "../secret.mcap",
        "..",
        "out",
        "{base}/secret.mcap",
        "{base}/root2/run.mcap",
        "{base}/root.mcap",
        "../root2/run.mcap",  # neighbours whose names begin alike
        "../root2",
        "../root.mcap",
        "../roo/run.mcap",
        "bags/../../root2/run.mcap",
        "link.mcap",
        "out/secret.mcap",
        "out/root2/run.mcap",
        "neighbour/run.mcap",
        "bags/../../secret.mcap",
        "/etc/passwd",
    ],
)
def test_no_path_leads_out(root: Path, name: str) -> None:
    """Nor to a folder whose name merely begins with that of the chosen one."""
    for other in ("root2", "roo"):
        (root.parent / other).mkdir()
        (root.parent / other / "run.mcap").write_text("secret")
    (root.parent / "root.mcap").write_text("secret")
    (root / "neighbour").symlink_to(root.parent / "root2")
    folder = Folder(root)
    with pytest.raises(InputError, match="leads out of"):
        folder.path(name.format(base=root.parent))
    assert folder.recordings() == ["bags/one", "lone.mcap", "table.CSV"]


def test_paths_within_may_go_round_about(root: Path) -> None:
    (root / "same.mcap").symlink_to(root / "lone.mcap")
    (root / "down").symlink_to(root / "bags")
    folder = Folder(root)
    for name, wanted in (
        ("bags/../lone.mcap", "lone.mcap"),
        ("../root/lone.mcap", "lone.mcap"),
        (f"{root}/table.CSV", "table.CSV"),
        ("same.mcap", "lone.mcap"),
        ("down/one", "bags/one"),
        (".", "."),
    ):
        assert folder.path(name) == root / wanted
    (root.parent / "alias").symlink_to(root)
    assert Folder(root.parent / "alias").path("lone.mcap") == root / "lone.mcap"


def test_what_is_not_there_is_said(root: Path) -> None:
    with pytest.raises(InputError, match=r"found 'no\.mcap', there is no such file"):
        Folder(root).path("no.mcap")
    with pytest.raises(InputError, match="zero byte"):
        Folder(root).path("a\0b")
    with pytest.raises(InputError, match="is no folder"):
        Folder(root / "rig.yaml")


def test_dropped_files_get_harmless_names() -> None:
    assert dropped_name("run 1.mcap") == "run_1.mcap"
    assert dropped_name("../../etc/cron.d/x.csv") == "x.csv"
    assert dropped_name("C:\\lab\\run.MCAP") == "run.MCAP"
    assert dropped_name("<img src=x onerror=alert(1)>.csv") == "_img_src_x_onerror_alert_1__.csv"
    assert len(dropped_name("a" * 500 + ".csv")) == 120
    assert dropped_name("a.mcap", LARGEST) == "a.mcap"
    with pytest.raises(InputError, match=r"found 4\.5 GiB, allowed are 4 GiB"):
        dropped_name("a.mcap", LARGEST + 2**29)
    for name in ("run.exe", "", ".mcap", "a.mcap.sh"):
        with pytest.raises(InputError, match=r"allowed are \.mcap, \.csv"):
            dropped_name(name)
