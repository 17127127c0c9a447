# SPDX-License-Identifier: Apache-2.0
"""A short digest of files, so that a page of figures says what it was made from."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def digest_of(paths: Iterable[Path]) -> str:
    """Twelve hexadecimal digits of the SHA-256 of files, folders taken whole, in order of name.

    Args:
        paths: Files and folders.
    """
    found: list[Path] = []
    for path in paths:
        found += sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    total = hashlib.sha256()
    for path in found:
        if "__pycache__" not in path.parts:
            total.update(path.name.encode())
            total.update(path.read_bytes())
    return total.hexdigest()[:12]


def sources_digest() -> str:
    """Digest of the simulator's and the identification's sources."""
    return digest_of(
        path
        for package in ("pneu_sim", "pneu_sysid")
        for path in sorted((ROOT / "src" / package / package).rglob("*.py"))
    )
