"""Environment of the processes of a graph: discovery on this host only, unless the user chooses otherwise.

This file does not import ROS, so that the command line can report a missing ROS in one sentence.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from pathlib import Path

from kr270_milling.base.arguments import one_thread_each
from kr270_milling.base.errors import MillingError
from kr270_milling.base.extensions import require_extra
from kr270_milling.base.parameter_file import find_file

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
#: set by the bootstrapper of the ROS wheels after it added this interpreter's libraries to LD_LIBRARY_PATH
GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
#: a node ends when its parent is no longer this process, so that a killed runner leaves no orphans
PARENT = "KR270_MILLING_PARENT"


def require_ros(what: str = "a graph of nodes") -> None:
    """Raise MillingError where rclpy is not installed."""
    require_extra(what, "ros", "rclpy", otherwise=", or source the setup file of an installed ROS 2")


def this_host_only(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the variables to add: the shipped profile and a discovery range, where the user has set none."""
    fast_dds = "rmw_fastrtps_cpp"
    if environ.get(RANGE, "LOCALHOST") != "LOCALHOST":
        return {}  # the user opens discovery to other hosts
    added = {RANGE: "LOCALHOST"}
    other = environ.get("RMW_IMPLEMENTATION", fast_dds) != fast_dds or any(environ.get(name) for name in PROFILES)
    if not other:
        added[PROFILES[0]] = str(Path(find_file("fastdds.xml")).resolve())
        if RANGE not in environ:  # the profile alone opens less: LOCALHOST adds sockets on every interface to send from
            added[RANGE] = "SYSTEM_DEFAULT"
    return added


def keep_to_this_host() -> None:
    """Set the variables of this process; call this before the first ROS context is created.

    Raises MillingError where the nodes would wait for each other without an end.
    """
    added = this_host_only(os.environ)
    os.environ.update(added)
    if not added:
        return
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:  # a datagram to this host itself
            end.bind(("127.0.0.1", 0))
            end.settimeout(2.0)  # [s]
            end.sendto(b"?", end.getsockname())
            end.recv(1)
    except OSError as error:
        reason = error.strerror or "no answer"
        raise MillingError(
            f"the loopback interface 127.0.0.1 does not work ({reason}), but the nodes need it; try: ip link set lo up"
        ) from None


def child_environment() -> dict[str, str]:
    """Return the environment of a node that this process starts, also with another interpreter."""
    environ = {**os.environ, **this_host_only(os.environ), PARENT: str(os.getpid())}
    environ.pop(GUARD, None)
    one_thread_each(environ)
    package = str(Path(__file__).resolve().parents[3])
    if "site-packages" not in package:  # a source checkout that is not installed
        environ["PYTHONPATH"] = os.pathsep.join(filter(None, [package, environ.get("PYTHONPATH")]))
    return environ
