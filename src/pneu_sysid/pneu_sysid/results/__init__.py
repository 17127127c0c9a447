# SPDX-License-Identifier: Apache-2.0
"""The JSON results of commands: what each holds, and how they are read and written."""
