"""Log times: every message of a recording on one clock, whatever the clock of its own stamp, or if it has none."""

from __future__ import annotations

__all__ = ["LogTimes"]

YEAR = 365 * 86_400 * 10**9  # [ns]; stamps that are further apart are of different clocks
#: types whose stamps may come from any clock beside that of the pass, so that they do not tell which one counts
BESIDE = ("diagnostic_msgs/", "rcl_interfaces/")


class LogTimes:
    """Gives the log time [ns] of each message: its own stamp, or the latest stamp where it has none that tells.

    The first stamp that tells decides the clock of the recording: time of the pass, counted from 0, or wall clock. A
    stamp of another clock counts as none; one such log time would make the recording last for decades. Before that
    first stamp there is no time to give (None), until ``begin`` says that no stamp is to be waited for.
    """

    def __init__(self, latest: int | None = None):
        self.latest = latest
        self._offset: int | None = None  #: from log time to stamp; None: no stamp that tells has come yet
        self._by_wall = False

    def begin(self, latest: int, by_wall: bool = False) -> None:
        """Wait no longer, where nothing told the time yet; by_wall: until a stamp does, it is the publish time."""
        if self.latest is None:
            self.latest, self._by_wall = latest, by_wall

    def of(self, kind: str, stamp: int | None, publish_time: int) -> int | None:
        if stamp == 0 and kind.startswith("trajectory_msgs/"):
            stamp = None  # it means "start at once" and says nothing of when it was published
        tells = stamp is not None and not kind.startswith(BESIDE)
        latest = stamp if self.latest is None and tells else self.latest
        if latest is None:
            return None
        if self._offset is None and tells and stamp is not None:  # what was begun without a stamp goes on from there
            self._offset = 0 if abs(stamp - latest) < YEAR else stamp - latest
        if self._offset is None and self._by_wall:
            latest = max(latest, publish_time)
        time = None if stamp is None else stamp - (self._offset or 0)
        usable = time is not None and time >= 0 and abs(time - latest) < YEAR
        self.latest = latest if time is None or not usable else max(latest, time)
        return time if usable else latest
