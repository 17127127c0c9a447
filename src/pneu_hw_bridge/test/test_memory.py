# SPDX-License-Identifier: Apache-2.0
"""What a bridge still knows when it is started again."""

import pytest

from pneu_hw_bridge.safety.memory import KILLED, Memory
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


@pytest.mark.parametrize("latches", [Latches(e_stop="somebody"), Latches(trip="over-pressure")])
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


@pytest.mark.parametrize("text", ["", "{", "[]", '{"bridge": 1}', "\x00" * 100])
def test_a_damaged_file_is_a_stop(text, tmp_path):
    one = memory(tmp_path)
    one.path.parent.mkdir()
    one.path.write_text(text)
    found = memory(tmp_path)
    assert "cannot be read" in found.recall().e_stop
    found.keep(Latches(e_stop="looked at"), driving=False)
    assert memory(tmp_path).recall().e_stop == "looked at"
