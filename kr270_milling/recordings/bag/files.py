"""Files of a recording: find them, open them; rosbag2's QoS profiles and ``metadata.yaml`` (version 9, as in Jazzy)."""

from __future__ import annotations

import functools
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import IO

import yaml
import zstandard

from kr270_milling.base import parameter_file as config_file
from kr270_milling.base.errors import ConfigError, RecordingError
from kr270_milling.base.parameter_file import parse
from kr270_milling.base.units import SECOND


def find_recording(path) -> Path:
    """Return the file of a recording, or its directory where rosbag2 wrote several files, a database or compressed
    messages. Raises RecordingError."""
    path = Path(path)
    if not path.is_dir() or _needs_rosbags(path):
        return path
    for kind in ("*.mcap", "*.mcap.zstd", "*.db3"):
        files = sorted(path.glob(kind))
        if len(files) == 1:
            return files[0]
        several = [str(file) for file in files] or sorted({str(file.parent) for file in path.glob(f"*/{kind}")})
        if several:
            more = f" and {len(several) - 8} more" if len(several) > 8 else ""
            reason = f"is no recording; name one of those in it: {', '.join(several[:8])}{more}"
            raise RecordingError(path, reason)
    raise RecordingError(path, "holds no recording (.mcap, .mcap.zstd or .db3)")


def is_rosbag(path: Path) -> bool:
    """Return whether rosbags reads a recording, and not mcap."""
    return path.is_dir() or path.suffix == ".db3"


def _needs_rosbags(directory: Path) -> bool:
    """Return whether ``metadata.yaml`` names several files, a database or compressed messages."""
    try:
        with open_to_read(directory / "metadata.yaml") as stream:
            text = stream.read(16 * 1024 * 1024).decode("utf-8", "replace")  # 16 MB
        about = parse(text, directory / "metadata.yaml", "")["rosbag2_bagfile_information"]
        files, mode = about["relative_file_paths"], str(about.get("compression_mode")).lower()
        return (
            (len(files) > 1 and directory.joinpath(Path(files[0]).name).is_file())
            or mode == "message"
            or (about["storage_identifier"] == "sqlite3")
        )
    except (RecordingError, ConfigError, LookupError, TypeError, AttributeError):
        return False


def open_to_read(path: Path) -> IO[bytes]:
    """Open a regular file; a file that ends in .zstd is unpacked into a temporary one. Raises RecordingError."""
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)  # opening a pipe must not block
    except (OSError, ValueError) as error:
        raise RecordingError(path, f"cannot be read: {getattr(error, 'strerror', error)}") from error
    stream = os.fdopen(file, "rb")
    if not stat.S_ISREG(os.fstat(file).st_mode):
        stream.close()
        raise RecordingError(path, "is not a file")
    return _unpacked(path, stream) if path.suffix in (".zstd", ".zst") else stream


def _unpacked(path: Path, packed: IO[bytes]) -> IO[bytes]:
    """Unpack a file as far as the disk has room. Raises RecordingError."""
    stream = tempfile.TemporaryFile()  # noqa: SIM115 - the caller closes the recording
    try:
        with packed, zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as content:
            while block := content.read(1024 * 1024):
                if shutil.disk_usage(tempfile.gettempdir()).free < 2**30:  # a GB remains on the disk
                    raise RecordingError(path, f"cannot be unpacked: {tempfile.gettempdir()} has no room for it")
                stream.write(block)
        stream.seek(0)
    except (zstandard.ZstdError, OSError, RecordingError) as error:
        stream.close()
        if isinstance(error, RecordingError):
            raise
        reason = f"cannot be unpacked ({error}); zstd -d {path.name} may save a part of it"
        raise RecordingError(path, reason) from error
    return stream


#: parts of a profile in the order of rosbag2
QOS = ("history", "depth", "reliability", "durability", "deadline", "lifespan", "liveliness",
       "liveliness_lease_duration", "avoid_ros_namespace_conventions")  # fmt: skip


def qos_text(profiles: Iterable) -> str:
    """Return the channel metadata ``offered_qos_profiles``: a YAML list of rclpy profiles, in the form of rosbag2."""

    def plain(value):
        if hasattr(value, "nanoseconds"):
            return dict(zip(("sec", "nsec"), divmod(value.nanoseconds, SECOND), strict=True))
        return value.name.lower() if hasattr(value, "name") else value

    return yaml_text([{key: plain(getattr(profile, key)) for key in QOS} for profile in profiles]).strip()


def yaml_text(value) -> str:
    """Return YAML without anchors, which are legal but which other readers may not know."""
    repeated = json.loads(json.dumps(value))  # equal parts are separate objects
    return yaml.dump(repeated, Dumper=getattr(yaml, "CSafeDumper", yaml.SafeDumper), sort_keys=False)


@functools.lru_cache(maxsize=32)
def read_qos(text: str) -> list[dict]:
    """Return the profiles in the metadata of a channel, unchanged; an empty list for a text that lists no mappings."""
    try:
        profiles = config_file.parse(text[:100_000], "", "offered_qos_profiles")
    except ConfigError:
        return []
    return profiles if isinstance(profiles, list) and all(isinstance(p, dict) for p in profiles) else []


def is_latched(metadata: Mapping[str, str]) -> bool:
    """Return whether every publisher of a channel repeats its last message for late subscribers."""
    profiles = read_qos(metadata.get("offered_qos_profiles", ""))
    # rosbag2 writes words since Jazzy and the numbers of the middleware before
    return bool(profiles) and all(profile.get("durability") in ("transient_local", 1) for profile in profiles)


def bag_information(file_name: str, channels: Iterable, start: int, end: int, custom: dict[str, str]) -> dict:
    """Return the content of ``metadata.yaml`` for one MCAP file.

    channels: the writer's WrittenChannel objects. start, end: first and last log time [ns]; 0 without messages.
    """
    topics = [
        dict(
            topic_metadata=dict(
                name=channel.topic,
                type=channel.type,
                serialization_format=channel.encoding,
                offered_qos_profiles=channel.qos,
                type_description_hash=channel.hash,
            ),
            message_count=channel.count,
        )
        for channel in channels
    ]
    count = sum(topic["message_count"] for topic in topics)
    starting = {"nanoseconds_since_epoch": start if count else 2**63 - 1}  # [ns]; rosbag2's duration without limit
    duration = {"nanoseconds": end - start if count else 0}
    return dict(
        version=9,
        storage_identifier="mcap",
        duration=duration,
        starting_time=starting,
        message_count=count,
        topics_with_message_count=topics,
        compression_format="",  # of whole files or messages; chunks are compressed separately
        compression_mode="",
        relative_file_paths=[file_name],
        files=[dict(path=file_name, starting_time=starting, duration=duration, message_count=count)],
        custom_data=custom,
        ros_distro="jazzy",
    )
