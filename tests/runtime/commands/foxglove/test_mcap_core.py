"""The file is read by the MCAP library of viewers, too: ``@mcap/core`` and ``@mcap/support`` of npm, where node has them.

``npm install @mcap/core @mcap/support`` anywhere, and NODE_PATH names its ``node_modules``; nothing else needs them.
"""

import json
from hashlib import sha256

import pytest

from tests.node import needs_packages, node
from tests.runtime.commands.foxglove.sessions import exported, finished_session, read_indexed
from tests.runtime.session.pair import job_of, pair_of

pytestmark = pytest.mark.processes

READ = """
const { readFileSync } = require("node:fs");
const { createHash } = require("node:crypto");
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { loadDecompressHandlers } = require("@mcap/support");
const digest = (data) => createHash("sha256").update(data).digest("hex");
const data = readFileSync(process.argv[1]);
const readable = {
  size: async () => BigInt(data.length),
  read: async (offset, size) => new Uint8Array(data.subarray(Number(offset), Number(offset + size))),
};
const told = (topic, message) => [topic, message.sequence, String(message.logTime), digest(message.data)];
async function read() {
  const decompressHandlers = await loadDecompressHandlers();
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const indexed = [], streamed = [], topics = {};
  for await (const message of reader.readMessages()) indexed.push(told(reader.channelsById.get(message.channelId).topic, message));
  const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true });
  stream.append(data);
  for (let record; (record = stream.nextRecord()); ) {
    if (record.type === "Channel") topics[record.id] = record.topic;
    if (record.type === "Message") streamed.push(told(topics[record.channelId], record));
  }
  console.log(JSON.stringify({ indexed, streamed, done: stream.done() }));
}
read();
"""


@pytest.fixture(scope="module", autouse=True)
def mcap_core():
    needs_packages("the export", "@mcap/core", "@mcap/support")


def test_the_export_gives_the_same_to_mcap_core(tmp_path, tmp_path_factory):
    with pair_of(tmp_path, *job_of(tmp_path_factory)) as pair:
        data = exported(finished_session(pair), tmp_path)
    file = tmp_path / "out.mcap"
    done = node(READ, file)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    wanted = [
        [channel.topic, message.sequence, str(message.log_time), sha256(message.data).hexdigest()]
        for _, channel, message in read_indexed(data)
    ]
    assert found["done"] is True
    assert sorted(found["streamed"]) == sorted(wanted)
    assert sorted(found["indexed"]) == sorted(wanted)
    assert len(wanted) > 300
