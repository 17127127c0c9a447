# SPDX-License-Identifier: Apache-2.0
"""Observer: the state of all gas and of what moves, from commands and whatever sensors there are.

An ensemble of rigs side by side is led by what the sensors read; see `observer`.
"""
