"""The files in readers that were not written here: rosbags, and Foxglove's packages for JavaScript."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from test_recording_samples import GRID, PERIOD, STORE, TOPICS, record, sample

from kr270_milling.recordings.bag.reader import Recording
from kr270_milling.recordings.bag.recover import recover

PACKAGES = ("@mcap/core", "@foxglove/rosmsg", "@foxglove/rosmsg2-serialization", "fzstd")
SCRIPT = """
const fs = require("fs"), crypto = require("crypto");
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");
const { decompress } = require("fzstd");
const decompressHandlers = { zstd: (data, size) => decompress(data, new Uint8Array(Number(size))) };
const plain = (_, v) => typeof v === "bigint" ? Number(v) : ArrayBuffer.isView(v) ? Array.from(v) : v;
const schemas = new Map(), channels = new Map(), readers = new Map();
function print(m) {
  const channel = channels.get(m.channelId), schema = schemas.get(channel.schemaId);
  if (!readers.has(m.channelId)) {
    readers.set(m.channelId, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
  }
  const sha = crypto.createHash("sha256").update(m.data).digest("hex");
  const value = readers.get(m.channelId).readMessage(m.data);
  console.log(JSON.stringify([channel.topic, Number(m.logTime), sha, value], plain));
}
async function indexed(file) {
  const handle = await fs.promises.open(file);
  const readable = {
    size: async () => BigInt((await handle.stat()).size),
    read: async (offset, length) => {
      const buffer = new Uint8Array(Number(length));
      await handle.read(buffer, 0, Number(length), Number(offset));
      return buffer;
    },
  };
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  reader.schemasById.forEach((v, k) => schemas.set(k, v));
  reader.channelsById.forEach((v, k) => channels.set(k, v));
  for await (const m of reader.readMessages()) print(m);
  const names = [];
  for await (const a of reader.readAttachments()) names.push(a.name);
  console.log(JSON.stringify(names));
  await handle.close();
}
function streamed(file) {
  const reader = new McapStreamReader({ decompressHandlers });
  reader.append(fs.readFileSync(file));
  for (let r; (r = reader.nextRecord()); ) {
    if (r.type === "Schema") schemas.set(r.id, r);
    if (r.type === "Channel") channels.set(r.id, r);
    if (r.type === "Message") print(r);
  }
}
const [mode, file] = process.argv.slice(-2);
mode === "indexed" ? indexed(file) : streamed(file);
"""


def order(messages) -> list:
    return sorted(messages, key=lambda m: (m[1], m[0]))


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    directory = tmp_path_factory.mktemp("bag") / "pass_1"
    written = record(directory, 25, attachments={"cell.yaml": "a: 1\n"}, chunk_size=20_000)
    return directory, written


@pytest.mark.parametrize("part", ["", "pass_1.mcap"])
def test_rosbags_reads_the_same_bytes_at_the_same_times(bag, part):
    directory, written = bag
    with Reader(directory / part) as reader:
        found = [(c.topic, t, bytes(d)) for c, t, d in reader.messages()]
        assert (reader.start_time, reader.end_time) == (0, 24 * PERIOD + 1)
        assert {k: (v.msgtype, v.msgcount) for k, v in reader.topics.items()} == {k: (v, 25) for k, v in TOPICS.items()}
        assert reader.ros_distro == (None if part else "jazzy")
    assert order(found) == order(written)


@pytest.mark.parametrize("part", ["", "pass_1.mcap"])
def test_rosbags_decodes_every_type_with_the_definitions_in_the_file(bag, part):
    directory, _ = bag
    with AnyReader([directory / part]) as reader:  # builds its types from the schemas in the file
        for connection, stamp, data in reader.messages():
            found = reader.deserialize(data, connection.msgtype)
            expected = sample(connection.topic, stamp // PERIOD)
            again = STORE.serialize_cdr(expected, expected.__msgtype__)
            assert bytes(reader.typestore.serialize_cdr(found, connection.msgtype)) == bytes(again)
            if connection.msgtype == GRID:
                np.testing.assert_array_equal(found.data, expected.data)


def test_rosbags_knows_the_profiles_that_were_offered(bag):
    directory, _ = bag
    with Reader(directory) as by_yaml, Reader(directory / "pass_1.mcap") as by_file:
        for connection, same in zip(by_yaml.connections, by_file.connections, strict=True):
            [profile] = connection.ext.offered_qos_profiles
            assert connection.ext == same.ext
            assert (profile.depth, profile.durability.name) == (1, "TRANSIENT_LOCAL")


def modules() -> Path | None:
    """Where the packages for node are: KR270_NODE_MODULES or one of NODE_PATH."""
    places = [os.environ.get("KR270_NODE_MODULES", ""), *os.environ.get("NODE_PATH", "").split(os.pathsep)]
    return next((Path(p) for p in places if p and all(Path(p, name).is_dir() for name in PACKAGES)), None)


def run_node(mode: str, file: Path) -> list:
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    if modules() is None:
        pytest.skip(f"set KR270_NODE_MODULES to a node_modules with {', '.join(PACKAGES)}")
    env = dict(os.environ, NODE_PATH=str(modules()))
    done = subprocess.run(["node", "-e", SCRIPT, "--", mode, str(file)], env=env, capture_output=True, text=True,
                          timeout=120)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def hashed(messages) -> list:
    return order([topic, at, hashlib.sha256(data).hexdigest()] for topic, at, data in messages)


def test_foxglove_reads_the_same_bytes_and_numbers(bag):
    directory, written = bag
    *lines, attachments = run_node("indexed", directory / "pass_1.mcap")
    assert attachments == ["cell.yaml"]
    assert [at for _, at, *_ in lines] == sorted(at for _, at, _ in written)
    assert order(line[:3] for line in lines) == hashed(written)
    values = {(topic, at // PERIOD): value for topic, at, _, value in lines}
    assert values["/tool_pose", 3]["pose"]["position"] == dict(x=3.0, y=3.1, z=3.2)
    assert values["/joint_states", 2]["position"] == (2 + 0.1 * np.arange(6)).tolist()
    assert values["/workpiece", 24]["data"] == [i % 101 for i in range(1000)]
    assert values["/diagnostics", 7]["status"][1]["values"] == [dict(key="correction", value="7")]
    assert values["/target_trajectory", 4]["points"][1]["transforms"][0]["rotation"] == dict(x=0, y=1, z=0, w=0)


def test_foxglove_reads_a_cut_off_file_and_the_recovered_one(bag, tmp_path):
    directory, written = bag
    whole = (directory / "pass_1.mcap").read_bytes()
    with Recording(directory) as recording:
        last = recording.chunks[-1]
    (tmp_path / "cut.mcap").write_bytes(whole[: last.offset + last.size // 2])
    result = recover(tmp_path / "cut.mcap")
    assert 0 < result.messages < len(written)
    expected = hashed(written[: result.messages])
    assert order(line[:3] for line in run_node("streamed", tmp_path / "cut.mcap")) == expected
    *lines, _ = run_node("indexed", tmp_path / "cut_recovered" / "cut_recovered.mcap")
    assert order(line[:3] for line in lines) == expected
