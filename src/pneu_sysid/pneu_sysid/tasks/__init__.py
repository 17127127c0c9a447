# SPDX-License-Identifier: Apache-2.0
"""Work on recordings as processes of their own, for nodes and pages: begun, followed, ended."""
