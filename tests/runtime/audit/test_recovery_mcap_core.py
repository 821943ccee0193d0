"""The copy is read by the MCAP library of viewers, too: ``@mcap/core`` of npm, where node and it are installed.

``npm install @mcap/core`` anywhere, and NODE_PATH names its ``node_modules``; nothing else needs it.
"""

import json
from hashlib import sha256

import pytest

from tests.node import needs_packages, node
from tests.runtime.audit.build import session_log
from tests.runtime.audit.cuts import Whole, recovered

pytestmark = pytest.mark.processes

READ = """
const { readFileSync } = require("node:fs");
const { createHash } = require("node:crypto");
const { McapIndexedReader } = require("@mcap/core");
const digest = (data) => createHash("sha256").update(data).digest("hex");
const readable = (data) => ({
  size: async () => BigInt(data.length),
  read: async (offset, size) => new Uint8Array(data.subarray(Number(offset), Number(offset + size))),
});
async function read(path) {
  const reader = await McapIndexedReader.Initialize({ readable: readable(readFileSync(path)) });
  const messages = [], attachments = [], metadata = [];
  for await (const message of reader.readMessages()) {
    const topic = reader.channelsById.get(message.channelId).topic;
    messages.push([topic, message.sequence, String(message.logTime), digest(message.data)]);
  }
  for await (const entry of reader.readAttachments()) attachments.push([entry.name, digest(entry.data)]);
  for await (const entry of reader.readMetadata()) metadata.push(entry.name);
  return { messages, attachments, metadata, counted: String(reader.statistics.messageCount) };
}
Promise.all(process.argv.slice(1).map(read)).then((all) => console.log(JSON.stringify(all)));
"""


@pytest.fixture(scope="module", autouse=True)
def mcap_core():
    needs_packages("the copy", "@mcap/core")


def by_python(whole, left):
    """The same, of what was whole in what was left."""
    messages, attachments = whole.kept(left)
    return {
        "messages": [
            [one.topic, one.sequence, str(one.log_time), sha256(one.data).hexdigest()] for one in messages
        ],
        "attachments": [[one.name, sha256(one.data).hexdigest()] for one in attachments],
        "metadata": ["cutgate", "cutgate.recovered"],
        "counted": str(len(messages)),
    }


def test_the_copy_gives_the_same_to_mcap_core(tmp_path):
    whole = Whole(session_log(tmp_path).log.read_bytes())
    copies, expected = [], []
    for cut in whole.seeded()[::10]:
        left = whole.data[:cut]
        found = recovered(left)
        if not isinstance(found, str):
            copies.append(tmp_path / f"{cut}.mcap")
            copies[-1].write_bytes(found[0])
            expected.append(by_python(whole, left))
    done = node(READ, *copies)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == expected
    assert len(expected) > 40
