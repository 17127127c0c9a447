# SPDX-License-Identifier: Apache-2.0
"""A running graph on the page: what is read, what a model makes of it, and the stop."""
