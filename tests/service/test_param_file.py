"""Parameters on disk: both forms are read, bad files change nothing, only run-time changes are kept."""

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError
from autopilot.core.params import PARAMETERS, ParamSet, ParamType
from autopilot.param_file import PersistentParams, read_param_file, write_param_file


@st.composite
def param_values(draw: st.DrawFn) -> dict[str, float]:
    values: dict[str, float] = {}
    for spec in draw(st.lists(st.sampled_from(PARAMETERS), unique=True)):
        if spec.type is ParamType.INT32:
            values[spec.name] = float(draw(st.integers(int(spec.minimum), int(spec.maximum))))
        else:
            values[spec.name] = draw(st.floats(spec.minimum, spec.maximum))
    return values


@given(param_values())
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, values: dict[str, float]) -> None:
    path = tmp_path_factory.mktemp("params") / "p.params"
    write_param_file(path, values)
    back = read_param_file(path)
    assert back.keys() == values.keys()
    for name, value in values.items():
        assert math.isclose(back[name], value, rel_tol=1e-8, abs_tol=1e-12)


def test_other_tools_forms_are_read(tmp_path: Path) -> None:
    path = tmp_path / "p.parm"
    path.write_text("# a comment\nTHR_LIMIT 9.5\nSPD_CRUISE,0.2\n\n1\t1\tFS_BATT_ACT\t1\t6\n")
    assert read_param_file(path) == {"THR_LIMIT": 9.5, "SPD_CRUISE": 0.2, "FS_BATT_ACT": 1.0}


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("NO_SUCH_PARAM 1", "NO_SUCH_PARAM"),
        ("THR_LIMIT 1e9", "THR_LIMIT"),
        ("THR_LIMIT nan", "THR_LIMIT"),
        ("THR_LIMIT many", "many"),
        ("FS_BATT_ACT 0.5", "FS_BATT_ACT"),
        ("THR_LIMIT", "THR_LIMIT"),
    ],
)
def test_a_bad_file_changes_nothing(tmp_path: Path, line: str, named: str) -> None:
    folder = tmp_path / "p.params"
    folder.write_text(f"SPD_CRUISE 0.2\n{line}\n")
    params = ParamSet()
    with pytest.raises(ConfigError, match=named) as caught:
        PersistentParams(folder, params).load()
    assert ":2:" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert dict(params) == dict(ParamSet())


def test_missing_and_binary_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        read_param_file(tmp_path / "nowhere.params")
    path = tmp_path / "binary.params"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="UTF-8"):
        read_param_file(path)


def test_only_changes_at_run_time_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "state" / "p.params"
    params = ParamSet()
    persistent = PersistentParams(path, params)
    params.set("THR_LIMIT", 8.0)  # as the command line would
    persistent.mark()
    persistent.save_changes()
    assert not path.exists()
    params.set("SPD_CRUISE", 0.3)  # as a client would
    persistent.save_changes()
    assert read_param_file(path) == {"SPD_CRUISE": 0.3}
    again = ParamSet()
    PersistentParams(path, again).load()
    assert again["SPD_CRUISE"] == 0.3
    assert again["THR_LIMIT"] == 12.0
