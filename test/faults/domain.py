"""A separate ROS domain for a run of faults: it does not disturb another graph and receives none of its messages."""

from __future__ import annotations

import os

from ros_domain import COUNT, is_used

__all__ = ["choose_domain"]


def choose_domain() -> str:
    """Set ROS_DOMAIN_ID where the user has not, to a domain without open ports; return a sentence about it."""
    if os.environ.get("ROS_DOMAIN_ID"):
        return f"ROS domain {os.environ['ROS_DOMAIN_ID']} (ROS_DOMAIN_ID)"
    number = next((number for number in range(COUNT, 0, -1) if not is_used(number)), 0)
    os.environ["ROS_DOMAIN_ID"] = str(number)
    return (
        f"ROS domain {number} (free; set ROS_DOMAIN_ID to choose another)" if number else "ROS domain 0 (none is free)"
    )
