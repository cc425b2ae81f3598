"""Parameters of a simulated run, and its links, which are opened before other modules are loaded."""

from pathlib import Path

from autopilot.core.background import BackgroundWorker
from autopilot.core.origin_params import set_origin_deg
from autopilot.core.param_file import PersistentParams, kept_params
from autopilot.core.params import ParamSet
from autopilot.run.boot_links import BootLinks, open_boot_links
from autopilot.run.config import EffectiveSettings
from autopilot.sitl.scenario import load_scenario
from autopilot.sitl.scenario_tables import Scenario


def open_sitl_links(settings: EffectiveSettings, overrides: dict[str, float], *, instance: int) -> BootLinks:
    """Open a SITL run's links; none is left open after an error. ConfigError, DriverError."""
    params, *_ = sitl_params(settings, load_scenario(settings["scenario"]), overrides, instance)
    folder = state_folder(settings, instance)
    return open_boot_links(settings["connect"], params, instance, settings["profile"], folder)


def sitl_params(
    settings: EffectiveSettings,
    scenario: Scenario,
    overrides: dict[str, float],
    instance: int,
    disk: BackgroundWorker | None = None,
) -> tuple[ParamSet, PersistentParams, tuple[str, ...]]:
    """Defaults < scenario's origin, tank, disturbance bounds and parameters < saved by earlier runs < command
    line. The last element returned lists problems of the saved ones. Without the worker of the ``disk`` they
    are read only: nothing is cleaned up or moved aside.
    """
    params = ParamSet()
    set_origin_deg(params, "ORIGIN_LAT", scenario.origin.lat_deg)
    set_origin_deg(params, "ORIGIN_LON", scenario.origin.lon_deg)
    params.set("ORIGIN_ALT", scenario.origin.alt_m)
    limits = scenario.controller
    for bound, value in (("MPC_W_FORCE", limits.disturbance_n), ("MPC_W_MOMENT", limits.disturbance_n_m)):
        if value is not None:
            params.set(bound, value)
    if scenario.tank is not None:
        params.set("FENCE_REQUIRED", 1)
    for name, value in scenario.params.items():
        params.set(name, value)
    persistent, warnings = kept_params(state_folder(settings, instance), params, overrides, disk)
    return params, persistent, warnings


def state_folder(settings: EffectiveSettings, instance: int) -> Path:
    """Folder of the files that an instance keeps between runs."""
    return Path(settings["state_dir"]) / f"sitl-{instance}"
