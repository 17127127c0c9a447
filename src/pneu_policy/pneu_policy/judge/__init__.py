# SPDX-License-Identifier: Apache-2.0
"""What controllers are worth: tasks, figures of merit, evaluations, the physical limit."""
