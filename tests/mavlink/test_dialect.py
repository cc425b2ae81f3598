"""The messages that the packaged dialect lacks: as its generator would make them, known to every decoder."""

import contextlib
import importlib.util
import io
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v10 import development as v10
from pymavlink.dialects.v20 import common
from pymavlink.generator import mavgen

from autopilot.mavlink.dialect import extra, mav
from autopilot.mavlink.extra_messages import DEFINITIONS
from autopilot.mavlink.mavlink1_sizes import MAVLINK1_SIZES
from autopilot.mavlink.wire import LinkEncoder, LinkParser


def test_every_message_is_as_pymavlinks_generator_writes_it(tmp_path: Path) -> None:
    out = tmp_path / "generated.py"
    with contextlib.redirect_stdout(io.StringIO()):
        assert mavgen.mavgen(mavgen.Opts(str(out), "2.0", language="Python3", validate=False), [str(DEFINITIONS)])
    spec = importlib.util.spec_from_file_location("generated", out)
    assert spec is not None and spec.loader is not None
    generated = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generated)
    assert generated.mavlink_map.keys() == extra.mavlink_map.keys()
    same = ("msgname", "crc_extra", "orders", "lengths", "array_lengths", "fieldenums_by_name", "fieldunits_by_name")
    for number, kind in generated.mavlink_map.items():
        ours = extra.mavlink_map[number]
        assert all(getattr(ours, name) == getattr(kind, name) for name in same), kind
        assert ours.unpacker.format == kind.unpacker.format
        for name in ("fieldnames", "ordered_fieldnames", "fieldtypes"):
            assert list(getattr(ours, name)) == getattr(kind, name)
    entries = {entry.name: value for enum in generated.enums.values() for value, entry in enum.items()}
    assert all(getattr(extra, name) == value for name, value in entries.items() if not name.endswith("_ENUM_END"))


def test_a_message_that_lacks_a_field_or_has_one_too_many_is_refused() -> None:
    cases: list[tuple[tuple[int, ...], dict[str, int]]] = [((1,), {}), ((1, 2, 3, 4), {}), ((1, 2), {"nonsense": 3})]
    for values, named in cases:
        with pytest.raises(TypeError, match="target_system, target_component, command"):
            extra.MAVLink_command_cancel_message(*values, **named)


def test_sizes_of_mavlink_1() -> None:
    assert {n: kind.unpacker.size for n, kind in v10.mavlink_map.items() if 0 <= n <= 255} == MAVLINK1_SIZES


def test_messages_that_both_dialects_have_agree_on_the_wire() -> None:
    both = set(common.mavlink_map) & set(extra.mavlink_map)
    assert {common.mavlink_map[number].msgname for number in both} == {
        "MISSION_CURRENT",
        "MISSION_COUNT",
        "MISSION_ACK",
        "TIMESYNC",
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
