"""Log of a session: one file with ``--log``, else one per arming in the log folder."""

import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from autopilot import __version__
from autopilot.command.service_parts import ServiceParts
from autopilot.core.errors import LogError
from autopilot.core.marker_files import marker_file_text
from autopilot.core.plan import PlanKind
from autopilot.log.description import RunDescription
from autopilot.log.log_session import RunLog, free_path, log_path, open_run_log, open_run_log_beside
from autopilot.log.quota import remove_old_logs
from autopilot.log.recover import recover_unfinished
from autopilot.log.writer import LogHead, Payload
from autopilot.record.estimator_setup import estimator_attachments
from autopilot.record.service_setup import (
    CURRENTS_FILE,
    SAME,
    SERVICE_FILE,
    START_PLANS_FILE,
    CurrentsRecord,
    ServiceRecord,
    SigningRecord,
)
from autopilot.run.compose import ServiceSetup
from autopilot.run.describe import plan_items, plans_json
from autopilot.run.plans_format import PlansSnapshot, encode
from autopilot.run.provenance import revision
from autopilot.run.recorder import RunRecorder
from autopilot.run.world import CurrentSource, World


class LogContents:
    """Initial content of a session's logs. Constant parts are made once at the start, not during a tick."""

    def __init__(self, world: World, setup: ServiceSetup, parts: ServiceParts) -> None:
        self._world, self._parts = world, parts
        known = world.known
        self._metadata = {
            "version": __version__,
            "revision": revision(),
            "vehicle": parts.vehicle.name,
            **world.metadata(),
        }
        self._attachments = {
            "config.json": msgspec.json.encode(world.settings.values(), enc_hook=str),
            "vehicle.json": msgspec.json.encode(parts.vehicle),
            **estimator_attachments(setup.estimator, parts.params, known.markers, known.floor_depth_m),
            **world.attachments(),
            **service_attachments(setup, parts, world.current_source),
        }
        if known.markers is not None and world.markers_from_file:
            self._attachments["markers.toml"] = marker_file_text(known.markers).encode()

    def description(self) -> RunDescription:
        return self._world.describe(self._parts)

    def plans(self) -> dict[str, Payload]:
        """The plans in force now, encoded by the caller."""
        items = plan_items(self._parts.plans)
        return {"plans.json": lambda: plans_json(items)}

    def head(self, path: Callable[[], Path], make_room: Callable[[], Sequence[Path]] = tuple) -> Callable[[], LogHead]:
        """Head of a new log, built on the writer's thread. ``make_room`` runs first; the logs that it has removed
        are named in the new one.
        """
        items = plan_items(self._parts.plans)

        def made() -> LogHead:
            removed = ", ".join(f"{log.parent.name}/{log.name}" for log in make_room())
            return LogHead(
                path=path(),
                metadata={
                    **self._metadata,
                    "started": datetime.now(UTC).isoformat(timespec="seconds"),
                    **({"removed_logs": removed} if removed else {}),
                },
                attachments={**self._attachments, "plans.json": plans_json(items)},
            )

        return made


def open_recorder(world: World, setup: ServiceSetup, parts: ServiceParts) -> RunRecorder:
    """Recorder of a session. LogError if its folder cannot be used. In lockstep a log is created and finished
    within the tick, for reproducibility; in paced runs in the background, except a file that exists from the
    start.
    """
    settings, lockstep = world.settings, world.speed == 0.0
    contents = LogContents(world, setup, parts)
    fixed = None if settings["log"] is None else Path(settings["log"])
    folder = Path(settings["log_dir"])
    if fixed is None:
        _make_folder(folder)
        recover_unfinished(folder)
    quota_bytes = round(settings["log_quota_mb"] * 1e6)
    camera_hz = settings["log_camera_hz"]
    period_us = round(1e6 / camera_hz) if camera_hz > 0.0 else None
    opened = 0

    def remove_old() -> Sequence[Path]:
        return remove_old_logs(folder, quota_bytes) if fixed is None and quota_bytes else ()

    def open_log(t_us: int) -> RunLog:
        nonlocal opened
        opened += 1
        at_start = opened == 1 and fixed is not None

        def path() -> Path:
            if fixed is None:
                return log_path(folder, time.time_ns(), last=bool(quota_bytes))  # the first by name are removed
            return fixed if at_start else free_path(fixed)

        head, description, epoch_ns = contents.head(path, remove_old), contents.description(), world.epoch_ns(t_us)
        if not (lockstep or at_start):
            return open_run_log_beside(head, epoch_ns=epoch_ns, description=description, camera_period_us=period_us)
        given = head()
        return open_run_log(
            given.path,
            epoch_ns=epoch_ns,
            description=description,
            metadata=given.metadata,
            attachments=given.attachments,
            lossless=lockstep,
            camera_period_us=period_us,
        )

    return RunRecorder(
        open_log,
        lambda: (contents.description(), contents.plans()),
        plan_revision=lambda: parts.plans.revision,
        truth=world.truth_source,
        per_arming=fixed is None,
        waits=lockstep,
    )


def _make_folder(folder: Path) -> None:
    """The log folder, now and not at the first arming. LogError if it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise LogError(f"log folder {folder}: cannot be made ({error.strerror}); choose another place") from error


def service_attachments(setup: ServiceSetup, parts: ServiceParts, current_source: CurrentSource) -> dict[str, bytes]:
    """Record of the service in its state before the first tick."""
    signing = None if setup.signing is None else setup.signing.state
    record = ServiceRecord(
        origin=(setup.origin.lat_deg, setup.origin.lon_deg, setup.origin.alt_m),
        currents=CurrentsRecord(
            kind=current_source.kind,
            basin=current_source.basin,
            map_suffix="" if current_source.map_file is None else current_source.map_file.suffix,
            map_start_utc=current_source.map_start,
        ),
        rates={str(link): rate for link, rate in setup.rates.items()},
        saving=setup.saving is not None,
        shelf=setup.log_directory is not None,
        signing=None if signing is None else SigningRecord(key=signing.key is not None, stamp=signing.stamp),
        parameters=dict(setup.params),
        **{name: getattr(setup, name) for name in SAME},
    )
    plans = parts.plans
    start = PlansSnapshot(
        configured_origin=setup.origin,
        origin=plans.origin,
        home_ned_m=plans.home_ned_m,
        items={kind: plans.items(kind) for kind in PlanKind},
        position=parts.commander.mission_position,
    )
    return {
        SERVICE_FILE: msgspec.json.encode(record),
        START_PLANS_FILE: encode(start),
        **({} if current_source.map_file is None else {CURRENTS_FILE: current_source.map_file.read_bytes()}),
    }
