"""Processor time and memory of a running service: the serving process and those that it started."""

from __future__ import annotations

import os
import re
from pathlib import Path

_MAPPING_FIELDS = 5  # behind the addresses of a mapping that has a name, in /proc/PID/smaps


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
    """Return the memory of all processes together: their own, and each mapped file once.

    Pages of their own that several of them share count once, in shares; those of files (the numerical
    libraries) count whole, so that it makes no difference who else on the machine maps them.
    """
    own_kb = 0
    of_file_kb: dict[str, int] = {}
    for one in descendants(pid):
        try:
            rollup = Path(f"/proc/{one}/smaps_rollup").read_text()
            mappings = Path(f"/proc/{one}/smaps").read_text()
        except (FileNotFoundError, ProcessLookupError, PermissionError):
            continue
        found = re.search(r"^Pss_Anon:\s+(\d+)", rollup, re.MULTILINE)
        own_kb += int(found.group(1)) if found else 0
        for name, size_kb in _file_kb(mappings).items():
            of_file_kb[name] = max(size_kb, of_file_kb.get(name, 0))
    return (own_kb + sum(of_file_kb.values())) / 1024


def _file_kb(mappings: str) -> dict[str, int]:
    """Return what is resident of each mapped file [kB], without pages that the process changed for itself."""
    name, sizes_kb = "", {}
    for line in mappings.splitlines():
        key, *values = line.split(maxsplit=5)
        if not key.endswith(":"):
            name = values[-1] if len(values) == _MAPPING_FIELDS else ""
        elif key == "Rss:":
            sizes_kb[name] = sizes_kb.get(name, 0) + int(values[0])
        elif key == "Anonymous:":
            sizes_kb[name] -= int(values[0])
    return sizes_kb


def _stat(pid: int) -> list[str]:
    """Return the fields of /proc/PID/stat behind the name: state, parent, ..."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
