# SPDX-License-Identifier: Apache-2.0
"""The gas kernel: compressible flow on networks of lines, many rigs at once.

Read `advance` first: it is the list of passes. `arrays` says what they work on.
"""

from pneu_sim.kernel.advance import WALL_EVERY as WALL_EVERY
from pneu_sim.kernel.advance import advance as advance
from pneu_sim.kernel.advance import advancing as advancing
from pneu_sim.kernel.arrays import Bodies as Bodies
from pneu_sim.kernel.arrays import Cells as Cells
from pneu_sim.kernel.arrays import Chambers as Chambers
from pneu_sim.kernel.arrays import Clock as Clock
from pneu_sim.kernel.arrays import Cylinders as Cylinders
from pneu_sim.kernel.arrays import Encoders as Encoders
from pneu_sim.kernel.arrays import Ends as Ends
from pneu_sim.kernel.arrays import Gas as Gas
from pneu_sim.kernel.arrays import Moving as Moving
from pneu_sim.kernel.arrays import Ports as Ports
from pneu_sim.kernel.arrays import Record as Record
from pneu_sim.kernel.arrays import Regulators as Regulators
from pneu_sim.kernel.arrays import Reservoirs as Reservoirs
from pneu_sim.kernel.arrays import Rigs as Rigs
from pneu_sim.kernel.arrays import Scheme as Scheme
from pneu_sim.kernel.arrays import Sides as Sides
from pneu_sim.kernel.arrays import Steps as Steps
from pneu_sim.kernel.arrays import Taps as Taps
from pneu_sim.kernel.arrays import Term as Term
from pneu_sim.kernel.bodies import stand as stand
from pneu_sim.kernel.chambers import chamber_pressure as chamber_pressure
from pneu_sim.kernel.leaks import leak_flow as leak_flow
from pneu_sim.kernel.orifices import iso6358_flow as iso6358_flow
from pneu_sim.kernel.orifices import orifice_flow as orifice_flow
from pneu_sim.kernel.pistons import count_cells as count_cells
from pneu_sim.kernel.pistons import lean as lean
from pneu_sim.kernel.pistons import settle as settle
