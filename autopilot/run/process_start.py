"""Start time of this process."""

import os
import time

_START_FIELD = 22 - 3
"""starttime in /proc/self/stat (proc_pid_stat(5), counted from 1), behind the name, which is the second of the fields
and may have blanks in it."""


def process_start_s() -> float:
    """Unix time; the present time if the system does not provide it."""
    now_s = time.time()
    try:
        with open("/proc/self/stat", encoding="ascii", errors="replace") as stream:
            fields = stream.read().rpartition(")")[2].split()
        began_s = int(fields[_START_FIELD]) / os.sysconf("SC_CLK_TCK")
        return now_s - max(0.0, time.clock_gettime(time.CLOCK_BOOTTIME) - began_s)
    except (OSError, ValueError, IndexError, AttributeError):
        return now_s
