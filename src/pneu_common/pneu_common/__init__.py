# SPDX-License-Identifier: Apache-2.0
"""What every package stands on: errors, files, documents, tables, progress, the `pneu` command.

It imports nothing of the others, so that any of them may import it.
"""
