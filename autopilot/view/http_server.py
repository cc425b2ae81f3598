"""HTTP server of the page: its files, a stream of server-sent events, and requests; or a log to play.

Pages of other sites get nothing, wherever the socket is bound (127.0.0.1 unless told otherwise). The Host of a request
has to be a name that no stranger's DNS can give, which rejects DNS rebinding; cross-site requests are rejected by
Origin or Sec-Fetch-Site; and requests that change anything need the process's token, which only the page has. There is
no CORS header here, and where a proxy adds one (BlueOS does) the Origin of the request has been rejected already.
"""

import hashlib
import importlib.metadata
import importlib.util
import ipaddress
import math
import secrets
import socket
import socketserver
import threading
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import msgspec

from autopilot.core.errors import AutopilotError, ConfigError
from autopilot.view.controls import ControlRequest, ViewError
from autopilot.view.hub import MAX_VIEWERS, Hub
from autopilot.view.log_frames import LogFrames

DEFAULT_PORT = 8760
PORTS = 20
"""Number of ports tried from the default on where none is given."""
PATIENCE_S = 2.0
"""Timeout of a viewer that receives nothing."""
REQUEST_S = 5.0
"""A request has to be there in that time."""
RETRY_MS = 1000
"""Interval at which a page that has lost its stream reconnects."""
SEND_BUFFER = 1 << 16
"""Kernel send buffer of a viewer; older data have no value."""
MAX_CONNECTIONS = 48
MAX_ASK_BYTES = 4096
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
LOOPBACK_ADDRESS = "127.0.0.1"
TOKEN_HEADER = "X-View-Token"

FOLDER = files("autopilot") / "data" / "view"
TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}
PAGES = {
    "/" if file.name == "index.html" else f"/{file.name}": (file.name, f"{TYPES[suffix]}; charset=utf-8")
    for file in sorted(FOLDER.iterdir(), key=lambda file: file.name)
    if (suffix := file.name.rpartition(".")[2]) in TYPES
}
"""Path -> file of the package, type."""
THREE_PATH = "/three.js"
SERVICE_PATH = "/register_service"
"""Where BlueOS asks each web server of its computer whether that is an extension, and how to show it."""
NO_THREE = "3-D needs three.js, which comes with the package pythreejs: pip install 'underwater-autopilot[view3d]'"

LOG_PATHS = {"/log": (), "/frames": ("from", "to", "step"), "/picture": ("t",), "/flow": ("t",)}
"""Of a log that is played: path -> times that it needs."""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self';"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "X-Accel-Buffering": "no",
}

_request = msgspec.json.Decoder(ControlRequest)


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    allow_reuse_address = True
    request_queue_size = 32

    def __init__(self, address: str, port: int, hub: Hub, log: LogFrames | None) -> None:
        self.hub, self.log, self.address = hub, log, address
        self.token = secrets.token_urlsafe(24)
        self.version = _version()
        self._connection_slots = threading.BoundedSemaphore(MAX_CONNECTIONS)
        super().__init__((address, port), _Handler)

    def server_bind(self) -> None:
        """Without http.server's look-up of the host's name, which a vehicle without a DNS would wait for."""
        socketserver.TCPServer.server_bind(self)

    def process_request(self, request: object, client_address: object) -> None:
        """In a thread of its own, up to a maximum number."""
        if not self._connection_slots.acquire(blocking=False):
            self.shutdown_request(request)  # type: ignore[arg-type]
            return
        super().process_request(request, client_address)  # type: ignore[arg-type]

    def process_request_thread(self, request: object, client_address: object) -> None:
        try:
            super().process_request_thread(request, client_address)  # type: ignore[arg-type]
        finally:
            self._connection_slots.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """Broken connections are ignored."""


def _file(name: str) -> bytes:
    """A packaged file of the page."""
    return (FOLDER / name).read_bytes()


def _three_js() -> Path | None:
    """three.js as it comes with pythreejs, found without importing that; None without it."""
    spec = importlib.util.find_spec("pythreejs")
    folders = [] if spec is None else spec.submodule_search_locations or []
    return next((file for folder in folders if (file := Path(folder) / "static" / "three.js").is_file()), None)


def _version() -> str:
    """Version of the page's code: browsers reload the page when it changes."""
    return hashlib.sha256(b"".join(_file(name) for name, _ in PAGES.values())).hexdigest()[:16]


def service_metadata() -> dict[str, str | bool]:
    """This program as an extension of BlueOS. Its page is proxied there, below a path of its own."""
    package = importlib.metadata.metadata("underwater-autopilot")
    return {
        "name": package["Name"].replace("-", " ").capitalize(),
        "description": package["Summary"],
        "icon": "mdi-submarine",
        "company": "The underwater-autopilot authors",
        "version": package["Version"],
        "webpage": "",
        "api": "",
        "works_in_relative_paths": True,
    }


def _is_own_name(host: str, address: str) -> bool:
    """Whether a request to the socket of ``address`` may be for ``host``. DNS rebinding needs a name that the
    attacker's DNS answers for: an address is none, and names in .local are the vehicle's network's own (mDNS)."""
    if host in LOOPBACK or address == LOOPBACK_ADDRESS:
        return host in LOOPBACK
    try:
        ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return host.endswith(".local")
    return True


class ViewServer:
    def __init__(
        self,
        port: int | None,
        log: LogFrames | None = None,
        option: str = "--view",
        address: str = LOOPBACK_ADDRESS,
    ) -> None:
        """ConfigError naming the ``option`` if the port is taken; without one the first free port from the default on
        is used. ``log``: played instead of a run. ``address``: of the interface to listen on, 0.0.0.0 = all."""
        self.hub, self._log, self._option, self._address = Hub(), log, option, address
        try:
            self._server = self._bound(port)
        except BaseException:
            self.hub.close()
            raise
        thread = threading.Thread(target=self._server.serve_forever, name="view http", daemon=True)
        thread.start()

    def _bound(self, port: int | None) -> _Server:
        for number in range(DEFAULT_PORT, DEFAULT_PORT + PORTS) if port is None else (port,):
            try:
                return _Server(self._address, number, self.hub, self._log)
            except OSError as error:
                reason = error.strerror or str(error)
        tried_ports = f"ports {DEFAULT_PORT} to {number}" if port is None else f"port {port}"
        raise ConfigError(
            f"{self._option}: {tried_ports} of {self._address} cannot be had ({reason}); give another one, or 0 for any"
        )

    @property
    def url(self) -> str:
        return f"http://{self._address}:{self._server.server_address[1]}/"

    def close(self) -> None:
        self.hub.close()
        self._server.shutdown()
        self._server.server_close()


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = REQUEST_S
    server_version = "autopilot"
    sys_version = ""

    def log_message(self, format: str, *args: object) -> None: ...

    def do_GET(self) -> None:
        """The page, its files, its stream."""
        url = urlsplit(self.path)
        if not self._from_here():
            return
        if self.server.log is not None and url.path in LOG_PATHS:
            self._play(self.server.log, url.path, parse_qs(url.query))
        elif self.server.log is None and url.path == "/events":
            self._stream(pictures=parse_qs(url.query).get("pictures") == ["1"])
        elif url.path in PAGES:
            name, kind = PAGES[url.path]
            missing = "" if _three_js() else escape(NO_THREE)
            marked = {
                b"@TOKEN@": self.server.token,
                b"@VERSION@": self.server.version,
                b"@NOTHREE@": missing,
                b"@SOURCE@": "live" if self.server.log is None else "log",
            }
            data = _file(name)
            for mark, text in marked.items() if name == "index.html" else ():
                data = data.replace(mark, text.encode())
            self._answer(200, data, kind)
        elif url.path == SERVICE_PATH:
            self._answer(200, msgspec.json.encode(service_metadata()), "application/json")
        elif url.path == THREE_PATH:
            three = _three_js()
            if three is None:
                self._say(404, NO_THREE)
            else:
                self._answer(200, three.read_bytes(), "text/javascript; charset=utf-8")
        else:
            self._say(404, "there is no such page; the view is at /")

    def do_POST(self) -> None:
        if not self._from_here() or not self._from_the_page():
            return
        controls = self.server.hub.controls
        try:
            length = int(self.headers.get("Content-Length", ""))
        except ValueError:
            length = -1
        if self.path != "/do":
            self._say(404, "ask at /do")
        elif not 0 < length <= MAX_ASK_BYTES:
            self._say(413, f"an ask has 1 to {MAX_ASK_BYTES} bytes")
        elif controls is None:
            self._say(409, "no run is under way; wait until the next has begun")
        else:
            try:
                done = controls.do(_request.decode(self.rfile.read(length)))
            except (msgspec.MsgspecError, UnicodeDecodeError) as error:
                self._say(400, f"not understood: {error}")
            except AutopilotError as error:
                self._say(409, str(error))
            else:
                self._answer(200, msgspec.json.encode({"done": done}), "application/json")

    def _from_here(self) -> bool:
        """Whether a browser requests our own page; others get an error."""
        host = self.headers.get("Host", "")
        name = host[: host.find("]") + 1] if host.startswith("[") else host.partition(":")[0]
        origin, site = self.headers.get("Origin"), self.headers.get("Sec-Fetch-Site")
        address = self.server.address
        if not _is_own_name(name.lower(), address) or len(self.headers.get_all("Host", [])) != 1:
            more = "" if address == LOOPBACK_ADDRESS else ", addresses and names in .local"
            self._say(403, f"this page answers to 127.0.0.1 and localhost{more} only")
        elif (origin is not None and origin != f"http://{host}") or site not in (None, "same-origin", "none"):
            self._say(403, "another page has no business here")
        else:
            return True
        return False

    def _from_the_page(self) -> bool:
        """Whether a change is requested by the page itself."""
        token = self.headers.get(TOKEN_HEADER, "")
        if self.headers.get("Origin") is None:
            self._say(403, "a browser names the page that asks; nobody else may")
        elif not secrets.compare_digest(token.encode(), self.server.token.encode()):
            self._say(403, "this page belongs to an earlier run; wait until it is connected again")
        elif self.headers.get_content_type() != "application/json":
            self._say(415, "ask as application/json")
        else:
            return True
        return False

    def _stream(self, *, pictures: bool) -> None:
        """Server-sent events until the viewer disconnects or times out."""
        viewer = self.server.hub.join(pictures=pictures)
        if viewer is None:
            self._say(503, f"{MAX_VIEWERS} pages are looking already: close one")
            return
        try:
            self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            self.connection.settimeout(PATIENCE_S)
            self._head(200, "text/event-stream", None)
            hello = msgspec.json.encode({"token": self.server.token, "version": self.server.version})
            self.wfile.write(b"retry: %d\nevent: hello\ndata: %b\n\n" % (RETRY_MS, hello))
            while (data := viewer.take()) is not None:
                self.wfile.write(data)
        except OSError:
            pass  # disconnected, or not receiving
        finally:
            self.server.hub.leave(viewer)

    def _play(self, log: LogFrames, path: str, query: dict[str, list[str]]) -> None:
        """A part of the log: what it is, frames, a picture, or the field of the current."""
        given: dict[str, float] = {}
        for name in LOG_PATHS[path]:
            text = query.get(name, [""])[-1]
            try:
                given[f"{name}_s"] = float(text)
            except ValueError:
                given[f"{name}_s"] = math.nan
            if not math.isfinite(given[f"{name}_s"]):
                self._say(400, f"{name}={text!r} is no time; give seconds")
                return
        answer: msgspec.Struct | None
        try:
            if path == "/log":
                answer = log.about()
            elif path == "/frames":
                answer = log.frames(**given)
            elif path == "/flow":
                answer = log.flow(**given)
            else:
                answer = log.picture(**given)
        except ViewError as error:
            self._say(400, str(error))
        except Exception as error:  # noqa: BLE001 - a damaged message: shown on the page, the rest can be played
            self._say(500, f"the log cannot be shown there ({type(error).__name__}: {error})")
        else:
            self._answer(200, msgspec.json.encode(answer), "application/json")

    def _say(self, code: int, text: str) -> None:
        self._answer(code, msgspec.json.encode({"error": text}), "application/json")

    def _answer(self, code: int, data: bytes, kind: str) -> None:
        self._head(code, kind, len(data))
        self.wfile.write(data)

    def _head(self, code: int, kind: str, length: int | None) -> None:
        self.send_response(code)
        for name, value in HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()
