// Print what Foxglove's packages read of a recording, one JSON line a message: node foxglove.js indexed|streamed FILE
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
