"""How much memory this process may use."""

from __future__ import annotations

import os

CGROUP_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
"""The files in which Linux states a container's memory limit: control groups version 2 and version 1."""


def usable_memory() -> int | None:
    """Return the bytes of the machine's memory, or of the container's limit if that is less; None: unknown."""
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
