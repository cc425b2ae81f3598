"""Figures and warnings about links to clients and about the process."""

import struct

import numpy as np

from autopilot.core.frames import FloatArray
from autopilot.core.marks import ServiceThread
from autopilot.log.analysis import FlightRecord, seconds
from autopilot.log.mavlink_frames import STX_V2
from autopilot.log.reader import MessageTable
from autopilot.log.rows import BoundRow, at_most, row

FEWEST = 50
"""Least number of messages for a share."""
MOST_LOST = 0.05
"""Share of received MAVLink messages that are missing by their numbers."""
MOST_ROUND_TRIP_S = 1.0
"""To a client and back: above, an operator acts on what has been."""
MOST_QUEUED = 10_000
"""Messages that wait for the log: half of its queue."""
MOST_GROWTH = 1.2
"""Memory at the end of the log over that in its middle,"""
LEAST_GROWTH_S = 60.0
"""if that was so long before."""
LEAST_CPU_MS_S = 1.0
"""CPU time per second of the vehicle's: threads below are not listed."""
TIMESYNC, ACK, ACK_ACCEPTED, ACK_IN_PROGRESS = 111, 77, 0, 5


def link_rows(flight: FlightRecord) -> list[BoundRow]:
    """Losses, response times and rejected data of the links."""
    rows = []
    received = flight.table("/in/mavlink")
    if received is not None and len(received):
        missing = lost_fraction(received)
        if missing is not None:
            rows.append(at_most("Links", "inbound MAVLink messages lost", "%", 100.0 * MOST_LOST, 100.0 * missing))
        mine = seconds(received)[flight.armed.holds(seconds(received))]
        if len(mine) > 1:
            rows.append(row("Links", "longest silence of all clients", "s", float(np.diff(mine).max())))
    sent = flight.table("/out/mavlink")
    if sent is not None and len(sent):
        refused = refused_commands(sent)
        note = ", ".join(f"{command} ({result})" for command, result in refused[:5])
        rows.append(row("Links", "commands refused", "", float(len(refused)), note and f"MAV_CMD (MAV_RESULT): {note}"))
        if received is not None:
            rows += _round_trips(flight, received, sent)
    return rows


def _round_trips(flight: FlightRecord, received: MessageTable, sent: MessageTable) -> list[BoundRow]:
    """From our TIMESYNC requests to their answers; simulated time is not that of clients unless at its own speed."""
    _, found_s = round_trips(received, sent)
    if not len(found_s):
        return []
    slow = float(np.percentile(found_s, 95.0))
    note = f"median {float(np.median(found_s)):.2f}, longest {found_s.max():.2f} s of {len(found_s)}"
    name = "MAVLink round trip, p95"
    if flight.run is not None and flight.run.speed not in (None, 1.0):
        return [row("Links", name, "s", slow, f"{note}; in simulated time")]
    return [at_most("Links", name, "s", MOST_ROUND_TRIP_S, slow, note)]


def round_trips(received: MessageTable, sent: MessageTable) -> tuple[FloatArray, FloatArray]:
    """(n,) times at which our TIMESYNC requests were answered and (n,) how long that took; they return our stamp."""
    requested = {ours for answer, ours, _ in _timesyncs(sent) if answer == 0}
    came = [
        (1e-6 * t_us, 1e-9 * ours) for answer, ours, t_us in _timesyncs(received) if answer != 0 and ours in requested
    ]
    at_s, requested_s = np.array(came, dtype=float).reshape(-1, 2).T
    return at_s, at_s - requested_s


def _timesyncs(frames: MessageTable) -> list[tuple[int, int, int]]:
    """tc1, ts1 and time [us] of every TIMESYNC."""
    data = frames["data"]
    those = (data[:, 0] == STX_V2) & (data[:, 7] == TIMESYNC) & (data[:, 8] == 0) & (data[:, 9] == 0)
    found = []
    for packet, t_us in zip(data[those], frames["t_us"][those].tolist(), strict=True):
        payload = bytes(packet[10 : 10 + int(packet[1])]).ljust(16, b"\0")  # zeros at the end are not sent
        found.append((*struct.unpack_from("<qq", payload), t_us))
    return found


def process_rows(flight: FlightRecord) -> list[BoundRow]:
    """Memory, the log's queue, and the garbage collector."""
    table = flight.table("/sys/process")
    if table is None or not len(table):
        return []
    rss, rows = table["rss"].astype(float), []
    if rss.any():
        rows.append(_memory(seconds(table), rss))
    depth = float(table["log_queue"].max())
    size = f"{1e-6 * float(table['log_queue_bytes'].max()):.1f} MB at most"
    in_time = flight.run is None or flight.run.speed != 0.0
    if in_time:
        rows.append(at_most("Service", "log queue", "", MOST_QUEUED, depth, size))
    else:
        rows.append(row("Service", "log queue", "", depth, f"{size}; in lockstep the loop waits"))
    rows.append(row("Service", "longest garbage collection", "ms", 1e3 * float(table["collect_s"].max())))
    return rows + _thread_rows(table)


def _thread_rows(table: MessageTable) -> list[BoundRow]:
    """CPU time of the threads that take some, the most first; none of a log of older versions."""
    if "thread_cpu_s" not in (table.dtype.names or ()):
        return []
    mean_ms, most_ms = 1e3 * table["thread_cpu_s"].mean(axis=0), 1e3 * table["thread_cpu_s"].max(axis=0)
    order = sorted(ServiceThread, key=lambda thread: -mean_ms[thread])
    return [
        row("Service", f"CPU, {thread.name.lower()}", "ms/s", float(mean_ms[thread]), f"at most {most_ms[thread]:.0f}")
        for thread in order
        if mean_ms[thread] >= LEAST_CPU_MS_S
    ]


def _memory(t_s: FloatArray, rss: FloatArray) -> BoundRow:
    """Peak memory, and growth over the second half of the log."""
    end, middle = float(rss[-1]), float(rss[len(rss) // 2])
    grown, lasted_s = end - middle, float(t_s[-1] - t_s[len(t_s) // 2])
    note = f"{1e-6 * grown:+.1f} MB in the last {lasted_s:.0f} s"
    if lasted_s < LEAST_GROWTH_S:
        return row("Service", "memory", "MB", 1e-6 * end, note)
    return at_most("Service", "memory", "MB", 1e-6 * MOST_GROWTH * middle, 1e-6 * end, note)


def lost_fraction(frames: MessageTable) -> float | None:
    """Share of messages missing by the sequence numbers of their senders; None with too few messages."""
    data = frames["data"]
    mine = (data[:, 0] == STX_V2) & (frames["length"] > 10)
    if int(mine.sum()) < FEWEST:
        return None
    heads = data[mine]
    senders = np.stack([frames["link"][mine], frames["client"][mine], heads[:, 5], heads[:, 6]], axis=1)
    missing = came = 0
    for sender in np.unique(senders, axis=0):
        numbers = heads[(senders == sender).all(axis=1), 4].astype(int)
        steps = (np.diff(numbers) - 1) % 256
        missing += int(steps[steps < 128].sum())  # more is a sender that has restarted, or packets out of order
        came += len(numbers)
    return missing / max(missing + came, 1)


def refused_commands(frames: MessageTable) -> list[tuple[int, int]]:
    """Command and result of every COMMAND_ACK that is not an acceptance."""
    data, length = frames["data"], frames["length"]
    acks = data[(data[:, 0] == STX_V2) & (length > 12) & (data[:, 7] == ACK) & (data[:, 8] == 0) & (data[:, 9] == 0)]
    found = []
    for ack in acks:
        result = int(ack[12]) if ack[1] > 2 else 0  # zeros at the end of a payload are not sent
        if result not in (ACK_ACCEPTED, ACK_IN_PROGRESS):
            found.append((int(ack[10]) | int(ack[11]) << 8, result))
    return found
