# SPDX-License-Identifier: Apache-2.0
"""What a bridge still knows when it is started again."""

import json
import os
from pathlib import Path

import pytest

from pneu_hw_bridge.safety.memory import KILLED, Memory, folder
from pneu_hw_bridge.safety.supervisor import Latches

pytestmark = pytest.mark.realtime


def memory(folder, bridge="/valve_bridge", device="127.0.0.1:1502 unit 1"):
    return Memory(bridge, device, folder)


def test_nothing_is_left_of_a_bridge_that_ended_well(tmp_path):
    one = memory(tmp_path)
    assert one.recall() == Latches()
    one.keep(Latches(), driving=True)
    assert one.path.exists()
    one.keep(Latches(), driving=False)
    assert not one.path.exists()
    assert memory(tmp_path).recall() == Latches()


@pytest.mark.parametrize(
    "latches",
    [
        Latches(e_stop="somebody"),
        Latches(trip="over-pressure"),
        Latches(e_stop="somebody", trip="over-pressure"),
    ],
)
def test_a_latch_is_kept_until_it_is_reset(latches, tmp_path):
    memory(tmp_path).keep(latches, driving=False)
    again = memory(tmp_path)
    assert again.recall() == latches
    assert memory(tmp_path, device="another").recall() == Latches()
    assert memory(tmp_path, bridge="/another").recall() == Latches()
    again.keep(Latches(), driving=False)
    assert memory(tmp_path).recall() == Latches()


def test_who_never_ended_was_killed(tmp_path):
    memory(tmp_path).keep(Latches(), driving=True)
    assert memory(tmp_path).recall() == Latches(e_stop=KILLED)


def test_why_it_was_stopped_comes_before_that_it_was_killed(tmp_path):
    memory(tmp_path).keep(Latches(e_stop="somebody", trip="over-pressure"), driving=True)
    assert memory(tmp_path).recall() == Latches(e_stop="somebody", trip="over-pressure")
    memory(tmp_path).keep(Latches(trip="over-pressure"), driving=True)
    assert memory(tmp_path).recall() == Latches(e_stop=KILLED, trip="over-pressure")


def test_the_file_says_whose_it_is_and_is_written_where_something_changed(tmp_path):
    one = memory(tmp_path)
    one.keep(Latches(), driving=False)
    assert not one.path.parent.exists(), "nothing is to be remembered"
    one.keep(Latches(trip="over-pressure"), driving=True)
    assert json.loads(one.path.read_text()) == {
        "bridge": "/valve_bridge",
        "device": "127.0.0.1:1502 unit 1",
        "e_stop": "",
        "trip": "over-pressure",
        "driving": True,
    }
    one.path.unlink()
    one.keep(Latches(trip="over-pressure"), driving=True)
    assert not one.path.exists(), "it has not changed"
    one.keep(Latches(), driving=False)
    assert not one.path.exists(), "it may be gone already"
    again = memory(tmp_path)
    again.keep(Latches(e_stop="somebody"), driving=False)
    again.recall()
    inode = again.path.stat().st_ino
    again.keep(Latches(e_stop="somebody"), driving=False)
    assert again.path.stat().st_ino == inode, "what was recalled is known to be there"
    assert os.listdir(again.path.parent) == [again.path.name]


@pytest.mark.parametrize(
    ("environment", "where"),
    [
        ({"PNEU_STATE_DIR": "/a", "XDG_STATE_HOME": "/b"}, "/a"),
        ({"PNEU_STATE_DIR": "", "XDG_STATE_HOME": "/b"}, "/b/pneu"),
        ({"XDG_STATE_HOME": ""}, "~/.local/state/pneu"),
    ],
)
def test_the_folder_is_that_of_the_environment(environment, where):
    assert folder(environment) == Path(where).expanduser()


def test_without_a_folder_it_is_the_users(tmp_path, monkeypatch):
    monkeypatch.setenv("PNEU_STATE_DIR", str(tmp_path))
    assert folder() == tmp_path
    assert Memory("/a", "b").path.parent == tmp_path / "bridges"


def test_a_file_that_cannot_be_read_is_a_stop(tmp_path):
    one = memory(tmp_path)
    one.path.mkdir(parents=True)
    assert "cannot be read" in one.recall().e_stop


@pytest.mark.parametrize("text", ["", "{", "[]", '{"bridge": 1}', "\x00" * 100])
def test_a_damaged_file_is_a_stop(text, tmp_path):
    one = memory(tmp_path)
    one.path.parent.mkdir()
    one.path.write_text(text)
    found = memory(tmp_path)
    assert "cannot be read" in found.recall().e_stop
    found.keep(Latches(e_stop="looked at"), driving=False)
    assert memory(tmp_path).recall().e_stop == "looked at"
