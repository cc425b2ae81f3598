"""Reading from Python: tables, alignment, pandas, and the example of the docs."""

import importlib.util
import math

import numpy as np
import pytest
from log_synthetic import Run, truth_at, write_run

from autopilot.core.errors import LogError
from autopilot.log.reader import Log, MessageTable, open_log


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    run = Run(laps=1, step_us=50_000, full_inputs=True)
    return open_log(write_run(tmp_path_factory.mktemp("api") / "run.mcap", run))


def test_aligned_topics_share_their_times(log: Log) -> None:
    found = log.align(["/nav/state", "/ctl/nmpc", "/nav/covariance"], rate_hz=8.0)
    first, *others = found.values()
    assert all(np.array_equal(first["t_us"], other["t_us"]) for other in others)
    np.testing.assert_allclose(np.diff(first["t_us"]), 125_000, atol=1)
    for row in (0, 40, -1):
        held_s = int(first["t_us"][row]) // 50_000 * 50_000 * 1e-6
        truth = truth_at(held_s)
        assert abs(found["/nav/state"]["pos_ned_m"][row, 1] - truth.pos_ned_m[1]) < 1e-9
    assert isinstance(first, MessageTable) and type(first["pos_ned_m"]) is np.ndarray
    assert isinstance(log["/nav/state"][:5], MessageTable)


def test_what_cannot_be_aligned_is_named(log: Log) -> None:
    with pytest.raises(LogError, match="above 0 Hz"):
        log.align(["/nav/state"], 0.0)
    for rate_hz in (math.inf, math.nan, 1e300):
        with pytest.raises(LogError, match="above 0 Hz"):
            log.align(["/nav/state"], rate_hz)
    with pytest.raises(LogError, match="needs a list of topics"):
        log.align("/nav/state", 10.0)
    with pytest.raises(LogError, match="/no/such"):
        log.align(["/nav/state", "/no/such"], 10.0)
    with pytest.raises(LogError, match="variable size"):
        log.align(["/rosout"], 10.0)


def test_pandas(log: Log) -> None:
    if importlib.util.find_spec("pandas") is None:
        with pytest.raises(LogError, match="pip install pandas"):
            log["/nav/state"].to_pandas()
        return
    frame = log["/nav/state"].to_pandas()
    assert len(frame) == len(log["/nav/state"]) and frame.index.name == "t_s"
    np.testing.assert_array_equal(frame["pos_ned_m[2]"], log["/nav/state"]["pos_ned_m"][:, 2])
    assert list(log) == [topic for topic, info in log.topics.items() if info.count]
    for topic in log:
        assert len(log.to_pandas(topic)) == log.topics[topic].count, topic
    assert log.to_pandas("/rosout")["msg"].iloc[0] == log.messages("/rosout")[0].value["msg"]


def test_xarray(log: Log) -> None:
    if importlib.util.find_spec("xarray") is None:
        with pytest.raises(LogError, match="pip install xarray"):
            log["/nav/state"].to_xarray()
        return
    data = log["/nav/state"].to_xarray()
    assert data["pos_ned_m"].dims == ("t_s", "pos_ned_m_0")
    np.testing.assert_array_equal(data["pos_ned_m"].values, log["/nav/state"]["pos_ned_m"])
    assert data.sel(t_s=data["t_s"][-1])["sequence"] == log["/nav/state"]["sequence"][-1]
    for topic in ("/sim/truth", "/out/thrusters", "/ctl/nmpc", "/in/ahrs_raw", "/nav/fit", "/sys/mode"):
        assert log[topic].to_xarray().sizes["t_s"] == len(log[topic])
