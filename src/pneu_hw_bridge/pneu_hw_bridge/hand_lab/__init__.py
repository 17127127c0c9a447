# SPDX-License-Identifier: Apache-2.0
"""Emulated devices of a hand: amplifiers, a Net F/T box, and the plant behind them.

`amplifier` is what an arm's driver talks to, `box` the force sensor as it is on the network,
`plant` moves what is behind them in real time. To the bridge all of it is hardware.
"""
