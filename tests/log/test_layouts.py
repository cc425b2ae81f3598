"""The layouts shipped for viewers: each topic and field that they name is in a log. And readers that are not ours."""

import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
from log_synthetic import Run, write_run

import autopilot
from autopilot.log.reader import Log, open_log

LAYOUTS = Path(autopilot.__file__).parent / "data" / "layouts"
READ_WITH_NODE = """
const {McapStreamReader} = require("@mcap/core"); const fs = require("fs");
const zstd = require("fzstd");
const reader = new McapStreamReader({validateCrcs: true, decompressHandlers: {zstd: b => zstd.decompress(b)}});
reader.append(fs.readFileSync(process.argv[1]));
let messages = 0; const topics = new Set();
for (let r; (r = reader.nextRecord()); ) {
  if (r.type === "Message") messages++;
  if (r.type === "Channel") topics.add(r.topic);
}
console.log(JSON.stringify({messages, topics: [...topics].sort()}));
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    run = Run(laps=1, step_us=100_000, full_inputs=True)
    return open_log(write_run(tmp_path_factory.mktemp("layouts") / "run.mcap", run))


def field_exists(log: Log, topic: str, field: str) -> bool:
    found = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", field)
    assert found is not None, field
    values = log[topic][found[1]]
    return found[2] is None or int(found[2]) < values.shape[1]


def strings(value: Any) -> list[str]:
    """Every text of a JSON document, names included."""
    if isinstance(value, dict):
        return [text for key, item in value.items() for text in (key, *strings(item))]
    if isinstance(value, list):
        return [text for item in value for text in strings(item)]
    return [value] if isinstance(value, str) else []


def test_foxglove_names_what_a_log_has(log: Log) -> None:
    layout = json.loads((LAYOUTS / "foxglove.json").read_text())
    named = [text for text in strings(layout) if text.startswith("/")]
    assert len(named) > 20
    for text in named:
        topic, _, field = text.partition(".")
        assert topic in log, text
        assert not field or field_exists(log, topic, field), text
    panels = set(re.findall(r'"(?:first|second)": "([^"]+)"', json.dumps(layout["layout"])))
    assert panels == set(layout["configById"])


def test_plotjuggler_names_what_a_log_has(log: Log) -> None:
    names = [curve.attrib["name"] for curve in ET.parse(LAYOUTS / "plotjuggler.xml").iter("curve")]
    assert len(names) > 12
    for name in names:
        topic, _, field = name.rpartition("/")
        assert topic in log and field_exists(log, topic, field), name


def test_foxgloves_own_reader_reads_it(log: Log) -> None:
    node = shutil.which("node")
    if (
        node is None
        or subprocess.run([node, "-e", "require('@mcap/core'); require('fzstd')"], capture_output=True).returncode
    ):
        pytest.skip("needs node with @mcap/core and fzstd (NODE_PATH)")
    done = subprocess.run([node, "-e", READ_WITH_NODE, str(log.path)], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["messages"] == log.message_count and found["topics"] == list(log.topics)
