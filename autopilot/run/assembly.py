"""What the sessions of a real and of a simulated vehicle are assembled of alike."""

from collections.abc import Callable
from dataclasses import dataclass

from autopilot.control.water.currents import CurrentForecast
from autopilot.core.geodesy import Origin
from autopilot.core.markers import MarkerMap
from autopilot.core.params import ParamSaving, ParamSet
from autopilot.core.vehicle import Vehicle
from autopilot.log.packing.vehicle import TruthLike
from autopilot.mavlink.api import SigningStore
from autopilot.mission.store import WaterCheck
from autopilot.run.compose import ServiceSetup
from autopilot.run.config import Settings, chosen_part
from autopilot.run.downloads import log_shelf
from autopilot.run.outside import Onlooker, Onlookers
from autopilot.run.session import FASTEST, link_rates
from autopilot.run.watched import WatchedService
from autopilot.view.controls import Controls
from autopilot.view.foxglove import FoxgloveServer
from autopilot.view.hub import Hub


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Told:
    """What a service is told of its vehicle and of the place, and nothing of the truth. The fields are those of
    :class:`autopilot.run.compose.ServiceSetup`; ``controller`` and ``estimator`` are those that fly unless the
    settings name others."""

    vehicle: Vehicle
    origin: Origin
    markers: MarkerMap | None
    floor_depth_m: float | None
    currents: CurrentForecast
    water: WaterCheck | None = None
    pictures: bool
    controller: str
    estimator: str


def service_setup(
    settings: Settings,
    told: Told,
    params: ParamSet,
    *,
    instance: int,
    links: int,
    speed: float,
    saving: ParamSaving,
    signing: SigningStore,
) -> ServiceSetup:
    """What the service for that vehicle and place is made of. ``links``: how many are open; ``speed``: of the world, 0
    = it waits for the service."""
    controller, controller_by = chosen_part(settings, "controller", told.controller)
    estimator, estimator_by = chosen_part(settings, "estimator", told.estimator)
    return ServiceSetup(
        vehicle=told.vehicle,
        params=params,
        origin=told.origin,
        markers=told.markers,
        floor_depth_m=told.floor_depth_m,
        estimator=estimator,
        estimator_asked_by=estimator_by,
        controller=controller,
        controller_asked_by=controller_by,
        profile=settings["profile"],
        instance=instance,
        currents=told.currents,
        water=told.water,
        links=links,
        patience=FASTEST if speed == 0.0 else max(1.0, speed),
        waits_for_plans=speed == 0.0,
        pictures=told.pictures,
        saving=saving,
        signing=signing,
        shelf=log_shelf(settings, patient=speed == 0.0),
        rates=link_rates(settings["connect"]),
    )


def onlooker(
    view: Hub | None,
    foxglove: FoxgloveServer | None,
    watched: WatchedService,
    vehicle: Vehicle,
    controls: Controls | None,
    *,
    simulated: bool,
    pictures: bool,
    truth: Callable[[], TruthLike | None] = lambda: None,
) -> Onlooker | None:
    """The loop's ends of the live view and of other viewers, None without any.

    ``controls``: what the page may do, for a view; ``simulated``: what it says of the run; ``pictures``: there is a
    camera that delivers some; ``truth``: where the vehicle really is, where that is known.
    """
    found: list[Onlooker] = []
    if view is not None and controls is not None:
        found.append(view.attach(watched, vehicle, controls, simulated=simulated, pictures=pictures))
    if foxglove is not None:
        found.append(foxglove.attach(watched.describe, watched.revision, truth))
    return Onlookers(*found) if found else None
