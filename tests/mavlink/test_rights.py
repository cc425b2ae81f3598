"""What nobody can take back: who may ask for it, and that all are told who has."""

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mavlink_harness import Client, MemoryStore, World, mav

from autopilot.core.background import BackgroundWorker
from autopilot.core.clients import Reach
from autopilot.core.messages import MavlinkFrame
from autopilot.log.directory_reader import LogDirectoryReader
from autopilot.mavlink.api import CommandResult
from autopilot.mavlink.operators import GRAVE, GRAVE_COMMANDS

TAKE, REBOOT, STORAGE = 32100, mav.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, mav.MAV_CMD_PREFLIGHT_STORAGE
KEY = bytes(range(32))


def message(made: Any) -> Callable[[Client], object]:
    return lambda client: client.send(made)


def command(number: int, value: float) -> Callable[[Client], object]:
    return message(mav.MAVLink_command_long_message(1, 1, number, 0, value, 0, 0, 0, 0, 0, 0))


ACTS = {
    "erase": (message(mav.MAVLink_log_erase_message(1, 1)), "All logs are being erased"),
    "restart": (command(REBOOT, 1.0), "Service restarts"),
    "end": (command(REBOOT, 2.0), "Service ends"),
    "key": (message(mav.MAVLink_setup_signing_message(1, 1, list(KEY), 0)), "Signing on"),
    "no key": (message(mav.MAVLink_setup_signing_message(1, 1, [0] * 32, 0)), "Signing off"),
    "reset": (command(STORAGE, 2.0), "Parameters set to defaults"),
}


class Near(Client):
    """A program of this machine: keys are taken from nobody else."""

    def take_tx(self) -> list[MavlinkFrame]:
        return [MavlinkFrame(link=f.link, data=f.data, client=f.client, reach=Reach.MACHINE) for f in super().take_tx()]


def disarmed(folder: Path) -> tuple[World, Client, Client, Client]:
    """A vehicle, who asks, and two others, one of them on another link."""
    (folder / "2026-11-22").mkdir()
    log = folder / "2026-11-22" / "10_00_00.mcap"
    log.write_bytes(bytes(100))
    world = World(links=(0, 1), signing=MemoryStore(None), log_directory=LogDirectoryReader(folder, BackgroundWorker()))
    world.show(armed=False, under_way=False)
    who = Near(world, sysid=66, compid=7, number=1)
    world.clients.append(who)
    others = world.client(sysid=254, number=2), world.client(link=1, sysid=253)
    for client in (who, *others):
        client.send(mav.MAVLink_heartbeat_message(6, 8, 0, 0, 0, 3))
    world.run(0.1)
    return world, who, *others


def has_happened(world: World, act: str) -> bool:
    """Whether it was done."""
    if act in ("restart", "end"):
        return "end_run" in [call[0] for call in world.vehicle.calls]
    if act == "reset":
        return bool(world.params["SPD_CRUISE"] == world.params.spec("SPD_CRUISE").default)
    inside = world.server
    if act == "erase":
        return inside._logs._erasing is not None or "Logs erased" in world.clients[0].texts()
    return bool((inside._ctx.signing.key is not None) == (act == "key"))


@pytest.mark.parametrize("act", ACTS)
def test_all_are_told_who_did_what_cannot_be_taken_back(act: str, tmp_path: Path) -> None:
    world, who, *others = disarmed(tmp_path)
    world.params.set("SPD_CRUISE", 0.2)
    ask, text = ACTS[act]
    ask(who)
    world.run(0.3)
    assert has_happened(world, act)
    for client in (who, *others):
        said = client.texts().replace("\n", "").split(text)[1:]
        assert said and "66/7" in said[0], client.texts()


@pytest.mark.parametrize("act", ACTS)
def test_by_parameter_only_the_operator_in_control_may(act: str, tmp_path: Path) -> None:
    """While nobody is in control nobody may, and nobody takes the parameter back."""
    world, who, other, _ = disarmed(tmp_path)
    world.params.set("SPD_CRUISE", 0.2)
    world.params.set("MAV_CTRL_NEEDED", 1)
    if act == "no key":
        world.server._ctx.signing.set_key(KEY, 0)
        world.server._ctx.signing.local_may_be_silent = True
        world.params.set("SIGN_LOCAL", 1)
    ask, text = ACTS[act]
    ask(who)
    world.run(0.3)
    assert not has_happened(world, act) and text not in other.texts()
    assert "take operator control first" in who.texts().replace("\n", "")
    who.send(mav.MAVLink_param_set_message(1, 1, b"MAV_CTRL_NEEDED", 0.0, mav.MAV_PARAM_TYPE_INT32))
    world.run(0.1)
    assert world.params["MAV_CTRL_NEEDED"] == 1 and who.got("PARAM_ERROR")
    if act == "no key":
        return  # who signs takes the key away: the same way as "key", once in control
    assert who.command(TAKE, 1.0) == CommandResult.ACCEPTED
    ask(other)
    world.run(0.3)
    assert not has_happened(world, act)
    ask(who)
    world.run(0.3)
    assert has_happened(world, act)


def test_what_is_grave_is_handled() -> None:
    """The table names nothing that the service does not know."""
    inside = World().server
    assert set(inside._handlers) >= GRAVE and set(inside._commands.table) >= GRAVE_COMMANDS


def test_the_page_of_threats_lists_all_that_the_service_handles() -> None:
    path = Path(__file__).resolve().parents[2] / "docs" / "strangers.py"
    spec = importlib.util.spec_from_file_location("strangers", path)
    assert spec is not None and spec.loader is not None
    strangers = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(strangers)
    rights = strangers.served()
    text = strangers.table(rights)
    assert strangers.page_with(text) == strangers.PAGE.read_text(encoding="utf-8"), "python docs/strangers.py --write"
    for group in (rights.anyone, rights.control, rights.grave):
        assert all(group)
