"""Where controller, estimator and plant of a run come from, for its log."""

from autopilot import __version__
from autopilot.control.protocol import find_controller
from autopilot.core.plugins import Plugin
from autopilot.estimator.create import find_estimator
from autopilot.log.description import PartOrigin
from autopilot.run.config import EffectiveSettings, chosen_part
from autopilot.sitl.protocol import find_plant
from autopilot.sitl.scenario_tables import Scenario


def part_origins(settings: EffectiveSettings, scenario: Scenario) -> dict[str, PartOrigin]:
    """By role. ConfigError if there is no such part."""
    told = scenario.plugins
    return {
        "controller": _origin(find_controller(*chosen_part(settings, "controller", told.controller))),
        "estimator": _origin(find_estimator(*chosen_part(settings, "estimator", told.estimator))),
        "plant": _origin(find_plant(*chosen_part(settings, "plant", told.plant))),
    }


def _origin(part: Plugin) -> PartOrigin:
    shipped = not part.version and not part.sha256
    version = f"underwater-autopilot {__version__}" if shipped else part.version
    return PartOrigin(name=part.name, target=part.target, version=version, sha256=part.sha256)
