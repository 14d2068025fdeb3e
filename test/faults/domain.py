"""A ROS domain of its own for the self test, so that it neither disturbs nor hears another graph."""

from __future__ import annotations

import os
from pathlib import Path

__all__ = ["choose_domain"]

PORTS = 7400, 250  # first UDP port of domain 0, and ports of a domain (RTPS, section 9.6.1)


def choose_domain() -> str:
    """Set ROS_DOMAIN_ID where the user has not, to one whose ports nobody has open; returns a sentence about it."""
    if os.environ.get("ROS_DOMAIN_ID"):
        return f"ROS domain {os.environ['ROS_DOMAIN_ID']} (ROS_DOMAIN_ID)"
    used = _ports()
    first, each = PORTS
    for number in range(101, 0, -1):
        if not any(first + each * number <= port < first + each * (number + 1) for port in used):
            os.environ["ROS_DOMAIN_ID"] = str(number)
            return f"ROS domain {number} (free; set ROS_DOMAIN_ID to choose another)"
    return "ROS domain 0 (no free one found)"


def _ports() -> set[int]:
    """UDP ports in use on this host."""
    found: set[int] = set()
    for table in ("udp", "udp6"):
        path = Path("/proc/net", table)
        if path.exists():
            found |= {int(line.split()[1].rpartition(":")[2], 16) for line in path.read_text().splitlines()[1:]}
    return found
