"""Name the commit that a number was measured on."""

from __future__ import annotations

import subprocess
from pathlib import Path


def commit() -> str | None:
    """Return the short name of the commit that is checked out; None outside a repository or without git."""
    try:
        found = subprocess.run(
            ["git", "rev-parse", "--short", "HEAD"],  # noqa: S607 - whichever git is installed
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=False,
        )
    except OSError:  # not installed, or a folder of the path that may not be searched
        return None
    return found.stdout.strip() or None
