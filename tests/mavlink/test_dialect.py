"""The messages that the packaged dialect lacks: generated, current, and known to every decoder of the service."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from pymavlink import __version__
from pymavlink.dialects.v20 import common

from autopilot.mavlink.dialect import extra, mav
from autopilot.mavlink.wire import LinkEncoder, LinkParser

ROOT = Path(__file__).resolve().parents[2]


def script() -> ModuleType:
    """docs/dialect.py."""
    spec = importlib.util.spec_from_file_location("dialect_script", ROOT / "docs" / "dialect.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def shape(module: Any) -> dict[int, tuple[Any, ...]]:
    """What of every message stands on the wire."""
    return {
        number: (kind.msgname, kind.crc_extra, kind.unpacker.format, tuple(kind.fieldnames), tuple(kind.array_lengths))
        for number, kind in module.mavlink_map.items()
    }


def test_generated_messages_are_current(tmp_path: Path) -> None:
    tool = script()
    text = tool.generated()
    committed = tool.MODULE.read_text(encoding="utf-8")
    if f"(pymavlink {__version__})" in committed:
        assert text == committed, "run python docs/dialect.py"
    (tmp_path / "fresh.py").write_text(text)
    spec = importlib.util.spec_from_file_location("fresh", tmp_path / "fresh.py")
    assert spec is not None and spec.loader is not None
    fresh = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(fresh)
    assert shape(fresh) == shape(extra)


def test_messages_that_both_dialects_have_agree_on_the_wire() -> None:
    both = set(common.mavlink_map) & set(extra.mavlink_map)
    assert {common.mavlink_map[number].msgname for number in both} == {
        "MISSION_CURRENT",
        "MISSION_COUNT",
        "MISSION_ACK",
    }
    for number in both:
        old, new = common.mavlink_map[number], extra.mavlink_map[number]
        assert old.crc_extra == new.crc_extra
        assert new.unpacker.format.startswith(old.unpacker.format)


@pytest.mark.parametrize("number", sorted(extra.mavlink_map))
def test_what_is_packed_is_decoded_with_all_fields(number: int) -> None:
    kind = extra.mavlink_map[number]
    values: list[Any] = []
    for name, field_type in zip(kind.fieldnames, kind.fieldtypes, strict=True):
        arrays = {"arguments": [1] * 40, "gcs_secondary": [0] * 9 + [7]}
        values.append(b"mftp:/general.json" if field_type == "char" else arrays.get(name, 1))
    message = kind(*values)
    (decoded,) = LinkParser().feed(LinkEncoder(1, 1).pack(message))
    assert decoded.get_type() == kind.msgname
    assert decoded.to_dict() == message.to_dict()


def test_the_packaged_decoder_knows_them() -> None:
    assert mav.mavlink_map[extra.MAVLINK_MSG_ID_CONTROL_STATUS].msgname == "CONTROL_STATUS"
    assert extra.MAV_RESULT_NOT_IN_CONTROL == 10
