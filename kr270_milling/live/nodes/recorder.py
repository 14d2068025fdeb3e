"""Node: write every topic of the graph to MCAP, as serialised messages."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from kr270_milling.base.errors import InputError, MillingError, RecordingError
from kr270_milling.base.samples import Text
from kr270_milling.live.nodes.recording_session import RecordingSession
from kr270_milling.live.ros.names import resolved_topic
from kr270_milling.live.ros.node import NOT_COMPLETE, OK, WARN, ManagedNode
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.topics import RECORDER

__all__ = ["Recorder"]


class Recorder(ManagedNode):
    """Record every topic (or those of the parameter ``topics``) to ``directory``/NAME.mcap while the node is active.

    Activation opens the file, which attaches the files of ``attach``; deactivation closes the file.
    """

    def __init__(self, **kwargs):
        super().__init__("recorder", autostart=True, **kwargs)
        self.session: RecordingSession | None = None  #: session of the open file
        patterns = self._texts("topics", "names, relative or absolute, with * and ?; empty: every topic")
        where = f"{self._where}: topics"
        self._topics = [t if "*" in t or "?" in t else resolved_topic(self, t, where) for t in patterns]
        about = "also record and publish /tf, /tf_static and /markers for viewers, where no other node publishes them"
        self._viewers = self.declared("viewers", True, about)
        about = "directory of the recording, which must not contain a recording; read when the node is activated"
        directory = self.declared("directory", "", about, read_only=False)
        self._texts("attach", "files to attach to the recording", read_only=False)
        self.declared("seed", "", "seed of the run, stored in the recording", read_only=False)
        about = "command line to store in the recording; empty: that of the node"
        self.declared("command", "", about, read_only=False)
        self.open_outlets(RECORDER)
        self._publish_name("")
        self.create_timer(0.1, self._discover)  # [s]
        if self.autostart and not directory:
            raise InputError(self._where, "directory is missing")
        self.report(OK, "not recording")
        if self.autostart:
            self._start_alone()
        if self.failure:
            raise MillingError(self.failure)

    @property
    def _where(self) -> str:
        return f"parameters of {self.get_fully_qualified_name()}"

    def _texts(self, name: str, about: str, **fields) -> list[str]:
        """Declare a parameter of one text, or of several as a list or separated by commas."""
        return _split(self.declared(name, "", about, dynamic_typing=True, **fields))

    def activate(self) -> None:
        command = self.get_parameter("command").value or shlex.join(sys.argv)
        metadata = {"command": command, "seed": self.get_parameter("seed").value}
        attachments = self._read(_split(self.get_parameter("attach").value))
        writer = BagWriter(self.get_parameter("directory").value, attachments=attachments, metadata=metadata)
        self.session = RecordingSession(self, writer, self._topics, self._viewers)
        self.session.discover()
        self._publish_name(f"{writer.path.parent.name}/{writer.path.name}")
        self.report(OK, f"recording to {writer.path}")

    def deactivate(self) -> None:
        self._publish_name("")
        session, self.session = self.session, None
        missing = 0 if session is None else session.close()
        if missing:
            self.report(WARN, f"{missing} messages of the pass were lost; {NOT_COMPLETE}")
        else:
            self.report(OK, "not recording")

    def _publish_name(self, name: str) -> None:
        self.set_values(recording=name)
        self.send([("recording", Text(name))])

    def _read(self, names: list[str]) -> dict[str, bytes]:
        try:
            return {Path(name).name: Path(name).read_bytes() for name in names}
        except OSError as error:
            raise InputError(self._where, f"attach: {error.filename} cannot be read ({error.strerror})") from None

    def _discover(self) -> None:
        if self.session is not None:
            self.session.discover()

    def watch(self) -> dict:
        return {} if self.session is None else self.session.watch()

    def close(self) -> str | None:
        """Close the file before the process ends; return a sentence if that failed."""
        session, self.session = self.session, None
        try:
            if session is not None:
                session.close()
        except RecordingError as error:
            return str(error)
        return None


def _split(value) -> list[str]:
    texts = value if isinstance(value, (list, tuple)) else str(value).split(",")
    return [text for text in (str(text).strip() for text in texts) if text]
