# SPDX-License-Identifier: Apache-2.0
"""Controllers of pressure: classical and learned, their training, evaluation and nodes."""
