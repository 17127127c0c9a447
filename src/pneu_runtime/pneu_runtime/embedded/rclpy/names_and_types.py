# SPDX-License-Identifier: Apache-2.0
"""The type of lists of names with their types."""

NamesAndTypes = list[tuple[str, list[str]]]
