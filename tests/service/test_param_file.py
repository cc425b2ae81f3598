"""Parameters on disk: both forms are read, bad files change nothing, only run-time changes are kept."""

import math
import re
import threading
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from autopilot.core.background import BackgroundWorker
from autopilot.core.daemon_executor import DaemonExecutor
from autopilot.core.errors import ConfigError
from autopilot.core.latest_value_writer import KEEP_TICKS, RETRY_TICKS, LatestValueWriter
from autopilot.core.param_file import PersistentParams, scan_param_file, write_param_file
from autopilot.core.params import PARAMETERS, ParamSet, ParamType


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
    back = scan_param_file(path).values
    assert back.keys() == values.keys()
    for name, value in values.items():
        assert math.isclose(back[name], value, rel_tol=1e-8, abs_tol=1e-12)


def test_other_tools_forms_are_read(tmp_path: Path) -> None:
    path = tmp_path / "p.parm"
    path.write_text("# a comment\nTHR_LIMIT 9.5\nSPD_CRUISE,0.2\n\n1\t1\tFS_BATT_ACT\t1\t6\n")
    assert scan_param_file(path).values == {"THR_LIMIT": 9.5, "SPD_CRUISE": 0.2, "FS_BATT_ACT": 1.0}


def test_a_file_saved_on_windows_is_read(tmp_path: Path) -> None:
    path = tmp_path / "p.params"
    path.write_bytes(b"\xef\xbb\xbfTHR_LIMIT 9.5\r\nSPD_CRUISE,0.2\r\n")
    assert scan_param_file(path).values == {"THR_LIMIT": 9.5, "SPD_CRUISE": 0.2}
    assert PersistentParams(path, ParamSet()).load() == ()


def test_a_parameter_with_two_values_is_named(tmp_path: Path) -> None:
    path = tmp_path / "p.params"
    path.write_text("SPD_CRUISE 0.2\nTHR_LIMIT 9\nSPD_CRUISE 0.2\nSPD_CRUISE 0.3\n")
    found = scan_param_file(path)
    assert found.values["SPD_CRUISE"] == 0.3
    assert found.repeated == (f"{path}:4: SPD_CRUISE = 0.3 after SPD_CRUISE = 0.2",)


BAD_LINES = [
    ("THR_LIMIT 1e9", "THR_LIMIT"),
    ("THR_LIMIT nan", "THR_LIMIT"),
    ("THR_LIMIT many", "many"),
    ("FS_BATT_ACT 0.5", "FS_BATT_ACT"),
    ("THR_LIMIT", "THR_LIMIT"),
]


@pytest.mark.parametrize(("line", "named"), BAD_LINES)
def test_a_bad_file_that_somebody_gives_is_an_error(tmp_path: Path, line: str, named: str) -> None:
    path = tmp_path / "p.params"
    path.write_text(f"SPD_CRUISE 0.2\n{line}\n")
    (error,) = scan_param_file(path).errors
    assert ":2:" in error and re.search(named, error)
    assert "\n" not in error


@pytest.mark.parametrize(("line", "named"), [*BAD_LINES, ("NO_SUCH_PARAM 1", "NO_SUCH_PARAM")])
def test_a_bad_line_does_not_keep_a_vehicle_from_starting(tmp_path: Path, line: str, named: str) -> None:
    """Everything else in the file is used; the line is named."""
    path = tmp_path / "p.params"
    path.write_text(f"SPD_CRUISE 0.2\n{line}\nDEPTH_MAX 1.5\n")
    params = ParamSet()
    (warning,) = PersistentParams(path, params).load()
    assert f"{path}:2: " in warning and named in warning and "\n" not in warning
    assert dict(params) == dict(ParamSet({"SPD_CRUISE": 0.2, "DEPTH_MAX": 1.5}))


def test_a_name_of_another_version_stays_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "p.params"
    path.write_text("1\t1\tFROM_TOMORROW\t7\t6\nSPD_CRUISE 0.2\n")
    params = ParamSet()
    persistent = PersistentParams(path, params)
    persistent.load()
    params.set("THR_LIMIT", 9.0)
    persistent.save(0, "THR_LIMIT")
    persistent.finish()
    assert "1\t1\tFROM_TOMORROW\t7\t6" in path.read_text().splitlines()
    assert scan_param_file(path).values == {"SPD_CRUISE": 0.2, "THR_LIMIT": 9.0}


@given(st.binary(max_size=300))
def test_no_content_keeps_a_vehicle_from_starting(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("params") / "p.params"
    path.write_bytes(data)
    PersistentParams(path, ParamSet()).load()


def test_missing_and_binary_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        scan_param_file(tmp_path / "nowhere.params")
    path = tmp_path / "binary.params"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="UTF-8"):
        scan_param_file(path)


def _set(persistent: PersistentParams, params: ParamSet, name: str, value: float) -> None:
    """As a client does, with the disk's answer."""
    params.set(name, value)
    number = persistent.save(0, name)
    if number is not None:
        saved = persistent.saved(KEEP_TICKS)
        assert saved is not None and saved.number == number


def test_only_changes_at_run_time_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "state" / "p.params"
    params = ParamSet()
    persistent = PersistentParams(path, params)
    params.set("THR_LIMIT", 8.0)  # as the command line would
    persistent.finish()
    assert not path.exists()
    _set(persistent, params, "SPD_CRUISE", 0.3)
    assert scan_param_file(path).values == {"SPD_CRUISE": 0.3}
    again = ParamSet()
    PersistentParams(path, again).load()
    assert again["SPD_CRUISE"] == 0.3
    assert again["THR_LIMIT"] == 12.0


def test_nothing_is_written_that_is_on_disk_already_and_a_failure_is_tried_again(tmp_path: Path) -> None:
    folder = tmp_path / "state"
    folder.write_bytes(b"in the way")
    params = ParamSet()
    persistent = PersistentParams(folder / "p.params", params)
    params.set("SPD_CRUISE", 0.3)
    assert persistent.save(0, "SPD_CRUISE") == 1
    assert persistent.saved(KEEP_TICKS - 1) is None
    failed = persistent.saved(KEEP_TICKS)
    assert failed is not None and failed.failure == "folder gone" and persistent.failure is not None
    folder.unlink()
    assert persistent.save(10, "SPD_CRUISE") == 2
    done = persistent.saved(10 + KEEP_TICKS)
    assert done is not None and done.failure == "" and persistent.failure is None
    assert persistent.save(30, "SPD_CRUISE") is None
    assert scan_param_file(folder / "p.params").values == {"SPD_CRUISE": 0.3}


def test_a_killed_service_leaves_nothing_behind_and_the_copy_before_helps(tmp_path: Path) -> None:
    path = tmp_path / "p.params"
    params = ParamSet()
    persistent = PersistentParams(path, params)
    _set(persistent, params, "SPD_CRUISE", 0.3)
    _set(persistent, params, "SPD_CRUISE", 0.4)
    (tmp_path / "p.params.new").write_bytes(b"1\t1\tSPD_")
    (tmp_path / "p.paramsab3_x9zz").write_bytes(b"as earlier versions left them")
    path.write_bytes(b"")
    again = ParamSet()
    (warning,) = PersistentParams(path, again).load()
    assert "is empty" in warning
    assert again["SPD_CRUISE"] == 0.3
    assert sorted(p.name for p in tmp_path.iterdir()) == ["p.params.damaged", "p.params.previous"]


def test_a_write_that_failed_is_tried_again_by_itself(tmp_path: Path) -> None:
    """The disk was full for a while: nobody has to change a parameter for it to be kept."""
    folder = tmp_path / "state"
    folder.write_bytes(b"in the way")
    params = ParamSet()
    persistent = PersistentParams(folder / "p.params", params)
    params.set("SPD_CRUISE", 0.3)
    persistent.save(0, "SPD_CRUISE")
    outcomes = []
    for tick in range(3 * RETRY_TICKS):
        if tick == RETRY_TICKS + 100:
            folder.unlink()
        saved = persistent.saved(tick)
        if saved is not None:
            outcomes.append(saved.failure)
    assert outcomes == ["folder gone", "folder gone", ""]
    assert persistent.failure is None
    assert scan_param_file(folder / "p.params").values == {"SPD_CRUISE": 0.3}


def test_a_disk_that_hangs_does_not_keep_a_service_from_ending() -> None:
    """The write never returns; the thread that does it is left behind."""
    stuck = threading.Event()
    watchdog: LatestValueWriter[int] = LatestValueWriter(
        BackgroundWorker(DaemonExecutor("stuck"), blocking=False), lambda _: bool(stuck.wait())
    )
    watchdog.put(0, 1)
    watchdog.put(0, 2)
    error = watchdog.finish(0.05)
    assert str(error) == "disk does not answer"
    stuck.set()
    assert watchdog.finish() is None
    assert all(thread.daemon for thread in threading.enumerate() if thread.name == "stuck")


def test_whatever_a_write_raises_the_run_ends() -> None:
    def write(state: int) -> None:
        raise ValueError(f"{state} has no bytes")

    for worker in (BackgroundWorker(), BackgroundWorker(DaemonExecutor("odd"), blocking=False)):
        watchdog: LatestValueWriter[int] = LatestValueWriter(worker, write)
        watchdog.put(0, 1)
        assert isinstance(watchdog.finish(), ValueError)
        worker.close()
