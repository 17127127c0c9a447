# SPDX-License-Identifier: Apache-2.0
"""One rig file: pipes, valves, chambers, taps, channels and topics; everything builds from it."""

from pneu_sim.rig.load import load_rig as load_rig
from pneu_sim.rig.load import save_rig as save_rig
from pneu_sim.rig.parameters import get_parameter as get_parameter
from pneu_sim.rig.parameters import rig_in_recording as rig_in_recording
from pneu_sim.rig.parameters import with_parameters as with_parameters
from pneu_sim.rig.schema import Rig as Rig
