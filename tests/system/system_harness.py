"""What the whole-system tests share."""

import socket
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from autopilot.sitl_session import SitlSession

ROOT = Path(__file__).resolve().parents[2]
PAPER_PLAN = ROOT / "sitl" / "scenarios" / "paper.plan"

OpenSession = Callable[..., SitlSession]


@dataclass(frozen=True, kw_only=True)
class RunningService:
    """A service in its own process."""

    process: subprocess.Popen[bytes]
    port: int
    log: Path


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    """A port that nobody uses now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
