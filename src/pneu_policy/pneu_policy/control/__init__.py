# SPDX-License-Identifier: Apache-2.0
"""Controllers: PID, feed-forward and learned policies, and the files that they come from."""
