# SPDX-License-Identifier: Apache-2.0
"""The catalogue of physical effects that a rig may have and a nominal model may lack."""

from pneu_sim.effects.base import POSITION as POSITION
from pneu_sim.effects.base import Comparison as Comparison
from pneu_sim.effects.base import Effect as Effect
from pneu_sim.effects.base import EffectParameter as EffectParameter
from pneu_sim.effects.base import position_along_pipe as position_along_pipe
from pneu_sim.effects.registry import apply_to_model as apply_to_model
from pneu_sim.effects.registry import apply_to_rig as apply_to_rig
from pneu_sim.effects.registry import find_effect as find_effect
from pneu_sim.effects.registry import load_effect_file as load_effect_file
from pneu_sim.effects.registry import registry as registry
