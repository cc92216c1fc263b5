"""The page's server: this machine only, answers what the page asks, and writes nothing."""

from __future__ import annotations

import json
import re
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

from smallwheel_ros.explore.page import problem_html, view_html, whole_page
from smallwheel_ros.explore.session import ExploreError, Session
from smallwheel_ros.explore.style import SCRIPT

HOST = "127.0.0.1"

_HTML, _TEXT = "text/html; charset=utf-8", "text/plain; charset=utf-8"
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
_KEYS = ("effects", "over")


class ExploreServer(ThreadingHTTPServer):
    """Serves one session. A browser opens connections in reserve: each has its own thread.

    Raises ExploreError where the port cannot be had; port 0 is any that is free.
    """

    def __init__(self, session: Session, port: int = 0) -> None:
        self.session = session
        self.lock = threading.Lock()  # a session, and matplotlib, serve one at a time
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            raise ExploreError(
                f"port {port} cannot be had ({error.strerror}): name another one with --port, or "
                "none for any that is free"
            ) from None

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server_address[1]}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say in one line what went wrong with a connection; one that the browser ended is none."""
        error = sys.exc_info()[1]
        if not isinstance(error, ConnectionError):
            print(f"explore: {type(error).__name__}: {error}", file=sys.stderr)


class _Handler(BaseHTTPRequestHandler):
    server: ExploreServer

    def do_GET(self) -> None:
        """Answer one request."""
        # Another site's name that leads to this machine must not read what is shown here.
        host = self.headers.get("Host", "")
        if not re.fullmatch(rf"({re.escape(HOST)}|localhost)(:\d+)?", host):
            self._send(403, _TEXT, f"asked for as '{host}': expected {HOST} or localhost")
            return
        if self.path != "/" and self._from_another_site(host):
            self._send(403, _TEXT, f"asked by another site: open http://{host}/ yourself")
            return
        parts = urlsplit(self.path)
        pages = {"/": self._page, "/view": self._view, "/model.yaml": self._model}
        if parts.path == "/explore.js":
            self._send(200, "text/javascript; charset=utf-8", SCRIPT)
        elif parts.path not in pages:
            self._send(404, _TEXT, f"no page '{parts.path}'")
        else:
            try:
                with self.server.lock:
                    names, over = self._asked(parts.query)
                    pages[parts.path](names, over)
            except ExploreError as error:
                self._send(400, _TEXT, str(error))

    def _from_another_site(self, host: str) -> bool:
        """Whether a page of another site asks: it may lead here, but start no fit.

        Browsers say so in Sec-Fetch-Site; those that do not, name the asking page (W3C Fetch
        Metadata; RFC 6454).
        """
        if self.headers.get("Sec-Fetch-Site", "none") not in ("none", "same-origin"):
            return True
        page = self.headers.get("Origin") or self.headers.get("Referer")
        return page is not None and not (page + "/").startswith(f"http://{host}/")

    def _asked(self, query: str) -> tuple[tuple[str, ...], str]:
        """Effects and covariate of a query; those to begin with where it is empty."""
        session = self.server.session
        found = parse_qs(query, keep_blank_values=True)
        for key in found:
            if key not in _KEYS:
                raise ExploreError(f"no setting '{key}': there is {' and '.join(_KEYS)}")
        names = found.get("effects", [] if found else list(session.chosen))
        return session.choose(names), session.setting(found.get("over", [None])[-1])

    def _page(self, names: tuple[str, ...], over: str) -> None:
        shown = self._shown(names, over)
        self._send(200, _HTML, whole_page(self.server.session, names, over, shown))

    def _view(self, names: tuple[str, ...], over: str) -> None:
        self._send(200, "application/json", json.dumps({"html": self._shown(names, over)}))

    def _shown(self, names: tuple[str, ...], over: str) -> str:
        """The view as HTML, or why there is none: what was asked for is fine, the fit is not."""
        session = self.server.session
        try:
            return view_html(session, session.view(names), over)
        except ExploreError as error:
            return problem_html(str(error))

    def _model(self, names: tuple[str, ...], over: str) -> None:
        session = self.server.session
        stem = re.sub(r"[^\w-]+", "_", "_".join([Path(session.measurements.source).stem, *names]))
        # Letters beyond ASCII in the form of RFC 5987; the plain name is for who cannot read that.
        plain = re.sub(r"[^\x21-\x7e]", "_", stem)
        disposition = f"attachment; filename=\"{plain}.yaml\"; filename*=UTF-8''{quote(stem)}.yaml"
        headers = {"Content-Disposition": disposition}
        self._send(200, "application/yaml", session.model_file(names), headers)

    def _send(
        self, status: int, kind: str, content: str | bytes, headers: dict[str, str] | None = None
    ) -> None:
        body = content.encode() if isinstance(content, str) else content
        self.send_response(status)
        for name, value in {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Content-Security-Policy": _POLICY,
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-store",
            **(headers or {}),
        }.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Keep quiet: the terminal is for what matters."""
