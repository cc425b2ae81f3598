"""The table of MAVSDK's plugins in docs/mavlink.md is that of the installed package, and rows are still so."""

import importlib.util
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

pytest.importorskip("mavsdk")

PATH = Path(__file__).parents[2] / "docs" / "mavsdk_table.py"


@pytest.fixture(name="table")
def table_fixture(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(PATH.parent)  # the modules beside it
    spec = importlib.util.spec_from_file_location("mavsdk_table", PATH)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mavsdk_table"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["mavsdk_table"]


def rows(text: str) -> dict[str, str]:
    return {found[1]: line for line in text.splitlines() if (found := re.match(r"\| (\w+) \|", line))}


def test_every_plugin_of_the_installed_package_is_in_the_table(table: ModuleType) -> None:
    written = rows(table.written())
    assert sorted(set(written) - {"plugin"}) == table.plugin_names()
    hanging = {name: line for name, line in written.items() if "hangs" in line}
    assert not hanging, "a client waits for ever"
    idle = re.findall(r"no effect: ([^;|]*?) ?[;|]", "\n".join(written.values()))
    assert idle == ["arm_force"], "what is acknowledged is done; MAVSDK 4.1.0 sends an order to disarm for this one"
    steers = {"set_position_ned", "set_velocity_ned", "set_velocity_body", "set_attitude"}
    assert steers <= set(re.split(r"[,|] ?", written["offboard"]))


def test_two_rows_are_as_they_are_written(table: ModuleType) -> None:
    now, written = rows(table.table(["ftp", "geofence"])), rows(table.written())
    assert [now[name] for name in ("ftp", "geofence")] == [written[name] for name in ("ftp", "geofence")]
