# SPDX-License-Identifier: Apache-2.0
"""The observer node on a graph: virtual taps and lines beside a simulator, bad parameters."""

import math
from pathlib import Path

import pytest

from tests.graph_fixtures import domain, graph  # isort: skip
from tests.live_graph import wait_for  # isort: skip

from diagnostic_msgs.msg import DiagnosticStatus
from pneu_msgs.msg import LineState, ValveCommand
from sensor_msgs.msg import FluidPressure

from pneu_common.errors import InputError
from pneu_graph.nodes import common
from pneu_sim.nodes.observer import ObserverNode
from pneu_sim.nodes.simulator import SimulatorNode
from pneu_sim.rig import load_rig

__all__ = ["domain", "graph"]  # fixtures

LAB = str(Path(__file__).parents[3] / "rigs/lab.yaml")


def observer(graph, **parameters):
    return graph.add(ObserverNode, **{"rig": LAB, "rate_hz": 50.0, "dx_m": 0.25, **parameters})


def test_it_tells_of_taps_and_lines_that_nobody_reads(graph):
    graph.add(SimulatorNode, rig=LAB, publish_rate_hz=100.0, command_timeout_s=0.0)
    observer(graph, used="valve_out, end")
    virtual = graph.listen(FluidPressure, "virtual/middle/pressure")
    true = graph.listen(FluidPressure, "taps/middle/pressure")
    lines = graph.listen(LineState, "observed/tube/state")
    publisher = graph.probe.create_publisher(ValveCommand, "valve/command", common.COMMAND_QOS)
    wait_for(lambda: publisher.get_subscription_count() == 1)
    publisher.publish(ValveCommand(name=["voltage"], voltage_v=[5.5]))
    wait_for(lambda: bool(true) and true[-1].fluid_pressure > 4e5)
    wait_for(lambda: bool(virtual) and virtual[-1].fluid_pressure > 3.9e5)

    def stamps(messages):
        return {common.from_stamp(m.header.stamp) for m in list(messages)}

    wait_for(lambda: len(stamps(true) & stamps(virtual)) > 3)
    assert virtual[-1].header.frame_id == "middle"
    assert 0.0 < virtual[-1].variance < 5e3**2
    wait_for(lambda: bool(lines))
    state = lines[-1]
    assert state.line == "tube"
    cells = round(load_rig(LAB).pipes["tube"].length_m / 0.25)
    assert len(state.position_m) == len(state.pressure_pa) == cells
    assert all(p > 0.0 and math.isfinite(p) for p in state.pressure_pa)
    assert graph.status("tap end").level in (DiagnosticStatus.OK, DiagnosticStatus.WARN)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"rig": ""}, "parameter rig: found nothing"),
        ({"used": "end, far"}, "parameter used: found 'far', rig 'lab' has supply"),
        ({"hears": "nothing"}, "hears"),
    ],
)
def test_bad_parameters_are_told_in_a_sentence(graph, parameters, words):
    with pytest.raises(InputError, match=words):
        observer(graph, **parameters)
