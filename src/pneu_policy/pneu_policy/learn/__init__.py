# SPDX-License-Identifier: Apache-2.0
"""Training of policies by the natural policy gradient; the only part that needs PyTorch."""
