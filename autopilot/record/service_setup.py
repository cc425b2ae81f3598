"""Record of a service's construction (attachment ``service.json``).

Vehicle, marker map and estimator have attachments of their own (:mod:`autopilot.record.estimator_setup`), and so
have the initial plans and mission progress (``start_plans.json``) and a map of the current (``currents_map``). Of a
signing key only its existence is recorded.
"""

import msgspec

from autopilot.core.errors import LogError
from autopilot.log.reader import Log

SERVICE_FILE = "service.json"
START_PLANS_FILE = "start_plans.json"
CURRENTS_FILE = "currents_map"
FORMAT = 1
"""Of the record and of ``/in/step``; grows when an older program cannot replay a newer log."""


class SigningRecord(msgspec.Struct, frozen=True, kw_only=True):
    key: bool
    """There was one at the start."""
    stamp: int
    """Signing time at the start."""


class CurrentsRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The controller's knowledge of the current."""

    kind: str
    """none, uniform, learned (``estimate``), map."""
    basin: str = "unknown"
    map_suffix: str = ""
    """Ending of the map's file, "" without one (the scenario's formula)."""
    map_start_utc: str | None = None


class ServiceRecord(msgspec.Struct, frozen=True, kw_only=True):
    format: int = FORMAT
    profile: str
    instance: int
    controller: str
    estimator: str
    origin: tuple[float, float, float]
    """Latitude, longitude [deg], altitude [m] of the local origin as configured."""
    floor_depth_m: float | None
    currents: CurrentsRecord
    links: int
    rates: dict[str, float]
    """Bytes per second of slow links, by number."""
    patience: float
    waits_for_plans: bool
    saving: bool
    """Whether parameters were kept on a disk."""
    shelf: bool
    """Whether there were logs to download."""
    pictures: bool = False
    """Whether there was a camera that delivered pictures."""
    signing: SigningRecord | None
    parameters: dict[str, float]
    """At the start."""
    git: str
    """Revision, as reported to clients."""


SAME = (
    *("profile", "instance", "controller", "estimator", "floor_depth_m"),
    *("links", "patience", "waits_for_plans", "pictures", "git"),
)
"""Fields that are those of :class:`autopilot.run.compose.ServiceSetup`."""


def read_record(log: Log) -> ServiceRecord:
    """Record of a log's service. LogError if it is missing, or of a newer version."""
    data = log.attachments.get(SERVICE_FILE)
    if data is None:
        raise LogError(
            f"{log.path}: has no attachment {SERVICE_FILE}: an older version has written it, or it is no log of a run; "
            "record the run with this version, or replay the estimator alone (--only estimator)"
        )
    try:
        head = msgspec.json.decode(data, type=_SetupHead)
        if head.format > FORMAT:
            raise LogError(
                f"{log.path}: {SERVICE_FILE} has format {head.format}, this version reads {FORMAT}; "
                "replay it with the version that has written it ('log info' names it)"
            )
        return msgspec.json.decode(data, type=ServiceRecord)
    except msgspec.MsgspecError as error:
        raise LogError(f"{log.path}: attachment {SERVICE_FILE}: {error}; the log is of another version") from error


class _SetupHead(msgspec.Struct, frozen=True):
    format: int = 0
