"""Node: write every topic of the graph to MCAP, as serialised messages."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from kr270_milling.base.errors import InputError, MillingError
from kr270_milling.base.samples import Text
from kr270_milling.live.nodes.recording_session import RecordingSession
from kr270_milling.live.ros.names import resolved_topic
from kr270_milling.live.ros.node import OK, ReportingNode
from kr270_milling.recordings.bag.writer import BagWriter
from kr270_milling.recordings.messages.topics import RECORDER

__all__ = ["Recorder"]


class Recorder(ReportingNode):
    """Record every topic (or those of the parameter ``topics``) to ``directory``/NAME.mcap until a signal.

    A new value of ``directory`` ends the recording and begins another there; an empty value only ends it.
    """

    def __init__(self, **kwargs):
        super().__init__("recorder", **kwargs)
        self._where = "parameters of " + self.get_fully_qualified_name()
        self.session: RecordingSession | None = None  #: session of the open file
        patterns = self._texts("topics", "names, relative or absolute, with * and ?; empty: every topic")
        self._topics = [
            t if "*" in t or "?" in t else resolved_topic(self, t, f"{self._where}: topics") for t in patterns
        ]
        about = "also record and publish /tf, /tf_static and /markers for viewers, where no other node publishes them"
        self._viewers = self.declared("viewers", True, about)
        about = "record from the start; false: from the moment when directory is set"
        self.open_outlets(RECORDER)
        self.set_values(recording="")
        autostart = self.declared("autostart", True, about)
        about = "directory of the recording, which must not contain a recording; a new value begins another recording"
        directory = self.declared("directory", "", about, read_only=False)
        self._texts("attach", "files to attach to the recording", read_only=False)
        self.declared("seed", "", "seed of the run, stored in the recording", read_only=False)
        about = "command line to store in the recording; empty: that of the node"
        self.declared("command", "", about, read_only=False)
        if autostart and not directory:
            raise InputError(self._where, "directory is missing")
        if autostart:
            self._begin(directory)
        else:
            self.report(OK, "waiting for a directory")
        self.add_on_set_parameters_callback(self._on_parameters)
        self.create_timer(0.1, self._discover)  # [s]

    def _texts(self, name: str, about: str, **fields) -> list[str]:
        """Declare a parameter of one text, or of several as a list or separated by commas."""
        return _split(self.declared(name, "", about, dynamic_typing=True, **fields))

    def _begin(self, directory: str) -> None:
        command = self.get_parameter("command").value or shlex.join(sys.argv)
        metadata = {"command": command, "seed": self.get_parameter("seed").value}
        attachments = self._read(_split(self.get_parameter("attach").value))
        writer = BagWriter(directory, attachments=attachments, metadata=metadata)
        self.session = RecordingSession(self, writer, self._topics, self._viewers)
        self._publish_name(f"{writer.path.parent.name}/{writer.path.name}")
        self.report(OK, f"recording to {writer.path}")

    def _publish_name(self, name: str) -> None:
        self.set_values(recording=name)
        self.send([("recording", Text(name))])

    def _read(self, names: list[str]) -> dict[str, bytes]:
        try:
            return {Path(name).name: Path(name).read_bytes() for name in names}
        except OSError as error:
            raise InputError(self._where, f"attach: {error.filename} cannot be read ({error.strerror})") from None

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        for directory in [p.value for p in parameters if p.name == "directory"]:
            if failed := self._end():
                self.end(failed)
                return SetParametersResult(successful=False, reason=failed)
            try:
                if directory:
                    self._begin(directory)
            except MillingError as error:
                return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _end(self) -> str | None:
        """End the open recording; return a sentence if that failed."""
        if self.session is not None:
            self._publish_name("")
            self.report(OK, "waiting for a directory")
        return self.close()

    def _discover(self) -> None:
        if self.session is not None:
            self.session.discover()

    def watch(self) -> dict:
        return {} if self.session is None else self.session.watch()

    def stamps(self) -> dict[str, int]:
        return {} if self.session is None else self.session.stamps()

    def close(self) -> str | None:
        """Close the file; return a sentence if that failed."""
        session, self.session = self.session, None
        return None if session is None else session.close()


def _split(value) -> list[str]:
    texts = value if isinstance(value, (list, tuple)) else str(value).split(",")
    return [text for text in (str(text).strip() for text in texts) if text]
