"""Processor time and memory of a running service: the serving process and those that it started."""

from __future__ import annotations

import os
import re
from pathlib import Path


def descendants(pid: int) -> list[int]:
    """Return the processes that come from a process, itself first."""
    children: dict[int, list[int]] = {}
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parent = int(_stat(int(folder.name))[1])
            except (FileNotFoundError, ProcessLookupError):
                continue
            children.setdefault(parent, []).append(int(folder.name))
    found = [pid]
    for one in found:
        found += sorted(children.get(one, []))
    return found


def cpu_s(pid: int) -> float:
    """Return the processor time that one process used, all threads together; 0 when it is gone."""
    try:
        fields = _stat(pid)
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def cpu_by_role(pid: int) -> dict[str, float]:
    """Return the processor time of the serving process and of its helpers together."""
    serving, *helpers = descendants(pid)
    return {"service": cpu_s(serving), "trackers": sum(map(cpu_s, helpers))}


def cores(before: dict[str, float], after: dict[str, float], spent_s: float) -> dict[str, float]:
    """Return how many processors each role kept busy."""
    return {name: round((after[name] - before[name]) / spent_s, 2) for name in after}


def resident_mb(pid: int) -> float:
    """Return the memory of all processes together; pages that several share count once."""
    total = 0
    for one in descendants(pid):
        try:
            text = Path(f"/proc/{one}/smaps_rollup").read_text()
        except (FileNotFoundError, ProcessLookupError, PermissionError):
            continue
        found = re.search(r"^Pss:\s+(\d+)", text, re.MULTILINE)
        total += int(found.group(1)) if found else 0
    return total / 1024


def _stat(pid: int) -> list[str]:
    """Return the fields of /proc/PID/stat behind the name: state, parent, ..."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
