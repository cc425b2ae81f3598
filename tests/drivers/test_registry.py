"""Back ends by name, connection strings, and that drivers stay light."""

import contextlib
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from autopilot.core.errors import ConfigError, DriverError
from autopilot.drivers import registry
from autopilot.drivers.links import DEFAULT_BAUD, Connection, parse_connection
from autopilot.drivers.registry import BACKENDS, backend_names, load_backend


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in BACKENDS.items() for name in names])
def test_every_back_end_can_be_loaded(kind: str, name: str) -> None:
    assert callable(load_backend(kind, name))


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    with pytest.raises(ConfigError, match="'lidar' is not known; use one of ellipse, ig500"):
        load_backend("ahrs", "lidar")
    with pytest.raises(ConfigError, match="'radar'; use one of ahrs"):
        backend_names("radar")


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry.BACKENDS["ahrs"], "odd", "library_that_is_not_there.driver:Odd")
    with pytest.raises(DriverError, match="needs the Python module 'library_that_is_not_there'"):
        load_backend("ahrs", "odd")


def test_registry_and_links_import_no_back_end() -> None:
    code = (
        "import sys, drivers.links\n"
        "ours = {f'autopilot.{name}' for name in ('drivers.udp', 'drivers.tcp', 'drivers.ig500', 'sitl')}\n"
        "heavy = ours | {'numpy', 'pymavlink', 'cv2'}\n"
        "sys.exit(','.join(sorted(heavy & set(sys.modules))) or None)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("text", "kind", "address", "number"),
    [
        ("udpout:127.0.0.1:14550", "udpout", "127.0.0.1", 14550),
        ("udpin:0.0.0.0:14540", "udpin", "0.0.0.0", 14540),
        ("udpin::14540", "udpin", "127.0.0.1", 14540),
        ("udp:127.0.0.1:14550", "udpin", "127.0.0.1", 14550),
        ("udp://:14540", "udpin", "127.0.0.1", 14540),
        ("udpin://0.0.0.0:14540", "udpin", "0.0.0.0", 14540),
        ("udpout://rover.local:14550", "udpout", "rover.local", 14550),
        ("tcp:127.0.0.1:5760", "tcpout", "127.0.0.1", 5760),
        ("tcp://127.0.0.1:5760", "tcpout", "127.0.0.1", 5760),
        ("tcpout://127.0.0.1:5760", "tcpout", "127.0.0.1", 5760),
        ("tcpin:0.0.0.0:5760", "tcpin", "0.0.0.0", 5760),
        ("tcpin://:5760", "tcpin", "127.0.0.1", 5760),
        ("/dev/ttyUSB0", "serial", "/dev/ttyUSB0", DEFAULT_BAUD),
        ("/dev/ttyUSB0:115200", "serial", "/dev/ttyUSB0", 115200),
        ("/dev/ttyUSB0,115200", "serial", "/dev/ttyUSB0", 115200),
        ("serial:///dev/ttyS1:921600", "serial", "/dev/ttyS1", 921600),
        ("COM4", "serial", "COM4", DEFAULT_BAUD),
    ],
)
def test_connection_strings(text: str, kind: str, address: str, number: int) -> None:
    assert parse_connection(text) == Connection(text=text, kind=kind, address=address, number=number)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "udpin",
        "udpin:127.0.0.1",
        "udpin:127.0.0.1:",
        "udp:h:70000",
        "udp:h:0",
        "udpout::14550",
        "tcp:5760",
        "usb:1",
        "serial:",
    ],
)
def test_malformed_connection_strings_are_refused_with_examples(text: str) -> None:
    with pytest.raises(ConfigError, match=r"udpout:127\.0\.0\.1:14550") as refusal:
        parse_connection(text)
    assert repr(text) in str(refusal.value)


@settings(deadline=None)
@given(st.text(max_size=30))
def test_any_text_is_understood_or_refused(text: str) -> None:
    with contextlib.suppress(ConfigError):
        assert parse_connection(text).number > 0
