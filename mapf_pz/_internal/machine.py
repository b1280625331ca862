"""The memory and the cores available to this process."""

from __future__ import annotations

import os

CGROUP_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
"""The files with a container's memory limit on Linux: control groups version 2 and version 1."""


def usable_memory() -> int | None:
    """Return the machine's memory in bytes, or the container's limit if that is less; None if unknown."""
    limits: list[int] = []
    if {"SC_PAGE_SIZE", "SC_PHYS_PAGES"} <= getattr(os, "sysconf_names", {}).keys():  # not on Windows
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for name in CGROUP_LIMITS:
        if os.path.isfile(name):
            with open(name) as file:
                text = file.read().strip()
            if text.isdigit():  # otherwise "max": no limit
                limits.append(int(text))
    return min(limits, default=None)


def usable_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
