"""Export of topics: CSV, and Parquet if pyarrow is installed.

One file per topic, one row per message: ``t_us`` and ``t_s`` on the service's clock, then the fields; arrays
element by element (``pos_ned_m[0]``), nested fields by their path (``orientation.x``). Topics of variable size
(paths, markers, pictures) have their lists as JSON, bytes as their length. Numbers keep full precision.
"""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from autopilot.core.disk import in_place_of, make_folder, write_whole
from autopilot.core.errors import LogError, UnknownNameError
from autopilot.core.names import did_you_mean
from autopilot.log.message_table import Columns
from autopilot.log.reader import Log

Kind: TypeAlias = Literal["csv", "parquet"]


def export_log(log: Log, folder: Path, *, topics: Sequence[str] = (), kind: Kind = "csv") -> Iterator[Path]:
    """Write topics as tables, one file per topic.

    Parameters
    ----------
    log
        The log.
    folder
        Created if it is missing.
    topics
        Their names, empty = all with messages.
    kind
        File format, ``csv`` or ``parquet``.

    Yields
    ------
    Path
        Each file when it is written.

    Raises
    ------
    LogError
        Unknown topic (of a damaged log it may be lost), missing library, or a requested topic cannot be decoded
        (without a request it is left out and named in ``log.problems``).
    """
    unknown = [topic for topic in topics if topic not in log.topics]
    if unknown:
        meant = did_you_mean(unknown[0], log.topics)
        text = f"{log.path}: has no topic {', '.join(unknown)}; {meant}it has {', '.join(log.topics) or 'none'}"
        raise LogError("; ".join((text, *log.problems))) if log.problems else UnknownNameError(text)
    writer = _writer(kind)
    try:
        make_folder(folder)
        for topic in topics or [name for name, info in log.topics.items() if info.count]:
            path = folder / f"{topic.strip('/').replace('/', '_')}.{kind}"
            try:
                columns = log.columns(topic)
            except LogError as error:
                if topics:
                    raise
                log.leave_out(topic, error)
                continue
            with in_place_of(path) as part:
                writer(part, columns)
            yield path
    except OSError as error:
        raise LogError(f"{folder}: cannot be written ({error.strerror or error}); choose another --out") from error


def export_stills(log: Log, folder: Path) -> Iterator[Path]:
    """Write the stills into ``folder``, named by their numbers; the files, as they are written.

    LogError if there are none.
    """
    images = log.messages("/payload/image") if "/payload/image" in log.topics else []
    if not images:
        raise LogError(f"{log.path}: has no stills; take some with IMAGE_START_CAPTURE")
    known = log["/payload/still"] if "/payload/still" in log.topics else None
    numbers = {} if known is None else dict(zip(known["t_us"].tolist(), known["index"].tolist(), strict=True))
    try:
        make_folder(folder)
        for place, image in enumerate(images):
            path = folder / f"{numbers.get(image.t_us, place):04d}.{image.value['format']}"
            write_whole(path, bytes(image.value["data"]))
            yield path
    except OSError as error:
        raise LogError(f"{folder}: cannot be written ({error.strerror or error}); choose another --stills") from error


def _writer(kind: Kind) -> Any:
    if kind == "csv":
        return _write_csv
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError as error:
        raise LogError(
            "Parquet needs pyarrow, the program's extra [analysis]: pip install '.[analysis]' where its source is, "
            "or pip install pyarrow; or export as CSV (--format csv)"
        ) from error
    return _write_parquet


def _write_csv(path: Path, columns: Columns) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        lists = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns.values()]
        writer.writerows(zip(*lists, strict=True))


def _write_parquet(path: Path, columns: Columns) -> None:
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table(columns), path, compression="zstd")
