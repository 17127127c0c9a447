# SPDX-License-Identifier: Apache-2.0
"""A Kokoro behind Modbus that a controller moves by the live graph: lab, bridge, node, targets."""

import os
import time
from contextlib import contextmanager

import numpy as np
from tests.live_graph import own_domain, running_graph, wait_for
from tests.live_rig import LaunchedNodes
from tests.measured import MachineStalledError, Watch
from tests.robots import kokoro_lab

from trajectory_msgs.msg import JointTrajectory  # isort: skip

from pneu_graph.nodes import common
from pneu_policy.control.planning import PLANS, PLANS_LATE

QUIET_S = 3.0
"""On a quiet machine all processes together wait for 1.7 to 2.1 s of the four that are judged, with
another program that computes for 4.9 to 8.1 s: only there the machine may be to blame."""
MOST_LATE = 0.1
"""Share of plans that come too late: on two quiet cores 0.03 at most, beside another program that
computes 0.4 and more."""
OVERRIDES = """
/**/joint_target:
  ros__parameters:
    kind: smooth
    low: -0.4
    high: 0.4
    period_s: 2.5
"""


@contextmanager
def running_robot(folder, rig, controller):
    """Runs a Kokoro with its lab, bridge, controller and targets; fails where a node complained.

    Args:
        folder: Where what is launched writes.
        rig: File of the rig as the graph knows it.
        controller: File of the controller.
    """
    with own_domain(), running_graph() as graph, kokoro_lab(folder) as lab:
        one = Robot(folder, lab, graph, rig, controller)
        one.nodes.launch()
        try:
            yield one
            assert not one.nodes.complaints()
        finally:
            one.nodes.close()


def _near(volts, wanted):
    return abs(volts - wanted) < 0.02


class Robot:
    """Lab, bridge, controller and targets of a Kokoro."""

    def __init__(self, folder, lab, graph, rig, controller):
        """Prepares.

        Args:
            folder: Where what is launched writes.
            lab: The lab.
            graph: Who listens.
            rig: File of the rig as the graph knows it.
            controller: File of the controller.
        """
        self.lab, self.graph = lab, graph
        self.nodes = LaunchedNodes(
            folder,
            OVERRIDES,
            rig=rig,
            registers="kokoro_plc",
            controller="robot",
            policy=controller,
            backend="modbus",
            port=lab.port,
        )
        self.targets = graph.listen(JointTrajectory, "/lab/joint_target", common.COMMAND_QOS)

    def elbow(self):
        return self.lab.ask("status")["encoders"]["elbow"]

    def wanted(self):
        return self.targets[-1].points[0].positions[0]

    def commanded(self):
        return any(self.lab.ask("status")["volts"].values())

    def closed(self):
        return all(_near(one, 5.0) for one in self.lab.ask("status")["volts"].values())

    def opened_since(self, time_s):
        """Voltages since then with which a valve was neither closed nor vented."""
        told = [self.lab.ask("status")["volts"]]
        history = self.lab.ask("history")["history"]
        told += [change["volts"] for change in history if change["steady_s"] >= time_s]
        volts = [one for each in told for one in each.values()]
        return [one for one in volts if not (_near(one, 5.0) or _near(one, 0.0))]

    def watch(self):
        return Watch(self.lab, [self.lab.process.pid, *self.nodes.pids().values(), os.getpid()])

    def rested_after(self, time_s):
        """Whether the valves have had their safe voltage since then."""
        rests = self.lab.ask("status")["safe"]
        return any(one["ended_s"] is None or one["ended_s"] > time_s for one in rests)

    def resting_since(self):
        rest = self.lab.ask("status")["safe"][-1]
        return None if rest["ended_s"] is not None else rest["begun_s"]

    def plans(self):
        """How many plans a predictive controller wanted so far, and how many came too late."""
        told = {v.key: v.value for v in self.graph.status("robot: control").values}
        return int(told.get(PLANS, 0)), int(told.get(PLANS_LATE, 0))

    def follow(self, share):
        """Fails unless it follows its targets for 4 s.

        Args:
            share: Most error, of the standard deviation of what is asked for.

        Raises:
            MachineStalledError: It does not, and the machine is to blame.
        """
        wait_for(self.commanded, 40.0)
        wait_for(lambda: len(self.targets) > 1, 10.0)
        wait_for(lambda: abs(self.elbow() - self.wanted()) < 0.05, 20.0)  # it lay at its stop
        watch, begun_s, plans = self.watch(), time.monotonic(), self.plans()
        off, told = [], []
        for _ in range(200):
            told.append(self.wanted())
            off.append(self.elbow() - told[-1])
            time.sleep(0.02)
        assert np.std(told) > 0.1
        if np.sqrt(np.mean(np.square(off))) < share * np.std(told):
            return
        asked, late = np.subtract(self.plans(), plans)
        if late > MOST_LATE * asked:
            raise MachineStalledError(f"{late} of {asked} plans were not made in time")
        # It falls where the valves were closed meanwhile, as they are when nobody commands in time.
        assert self.rested_after(begun_s)
        stalled_s = watch.stalled_s(begun_s, time.monotonic())
        assert stalled_s > QUIET_S
        raise MachineStalledError(f"the valves were closed; the machine stalled {stalled_s:.2f} s")
