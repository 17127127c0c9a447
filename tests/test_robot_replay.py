# SPDX-License-Identifier: Apache-2.0
"""A Kokoro that is simulated, recorded and replayed by the one launch file."""

import time

import pytest
from tests.live_graph import own_domain, running_graph, wait_for
from tests.live_rig import LaunchedNodes
from tests.robots import KOKORO

from sensor_msgs.msg import JointState  # isort: skip

from pneu_graph.nodes import common

pytestmark = pytest.mark.realtime

OVERRIDES = """
/**/excite:
  ros__parameters:
    swing: true
"""


def stamp(message):
    return common.from_stamp(message.header.stamp)


@pytest.mark.long
def test_a_simulated_robot_is_recorded_and_replayed_by_the_same_launch_file(tmp_path):
    with own_domain(), running_graph() as graph:
        arguments = {"rig": KOKORO, "controller": "excite", "view": "true"}
        nodes = LaunchedNodes(tmp_path, OVERRIDES, **arguments)
        try:
            told = graph.listen(JointState, "/joint_states", common.READINGS_QOS)
            nodes.launch(backend="sim", record=tmp_path / "bag")
            wait_for(lambda: len(told) > 400, 90.0)
            for name in list(nodes.running):
                assert nodes.end(name) == 0, nodes.log(name).read_text()[-2000:]
            assert not nodes.complaints()
            simulated = {stamp(m): m.position[0] for m in list(told)}
            told.clear()
            nodes.launch(
                backend="replay", bag=tmp_path / "bag", controller="none", use_sim_time="true"
            )
            # the recording may begin before the simulator was heard here
            wait_for(lambda: simulated.keys() & {stamp(m) for m in list(told)}, 60.0)
            time.sleep(1.0)
            again = {stamp(m): m.position[0] for m in list(told)}
            common_stamps = simulated.keys() & again.keys()
            assert len(common_stamps) > 100
            assert all(simulated[at] == again[at] for at in common_stamps)
            assert max(again.values()) - min(again.values()) > 0.1
        finally:
            nodes.close()
