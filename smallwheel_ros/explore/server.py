# SPDX-License-Identifier: Apache-2.0
"""The page's server: this machine only, answers what the page asks, and writes nothing."""

from __future__ import annotations

import hmac
import json
import re
import secrets
import sys
import threading
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, quote, urlsplit

from smallwheel_ros.explore.data import SessionData
from smallwheel_ros.explore.session import ExploreError, Session
from smallwheel_ros.report.blocks import drawn
from smallwheel_ros.report.diagnosis import diagnosis_page
from smallwheel_ros.report.learnt import learnt_page

HOST = "127.0.0.1"

_HTML, _TEXT = "text/html; charset=utf-8", "text/plain; charset=utf-8"
_JSON = "application/json"
_PAUSE = 0.05  # s, in which a request can take its turn
_SILENCE = 30.0  # s after which a connection that says nothing is closed
_POLICY = (  # beside that of the page, which names the one script that may run
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
_KEYS = ("effects", "over", "run")


class ExploreServer(ThreadingHTTPServer):
    """Serves one session. A browser opens connections in reserve: each has its own thread.

    The address holds a secret: pages of other sites, and other users of this machine, cannot ask without it.

    Raises ExploreError where the port cannot be had; port 0 is any that is free.
    """

    def __init__(self, session: Session, port: int = 0) -> None:
        self.session = session
        self._secret = secrets.token_urlsafe(16)
        self.lock = threading.Lock()  # a session serves one at a time
        self.asking: set[int] = set()  # threads of requests that want it
        self._ended = threading.Event()
        try:
            super().__init__((HOST, port), _Handler)
        except OSError as error:
            raise ExploreError(
                f"port {port} cannot be had ({error.strerror}): name another one with --port, or "
                "none for any that is free"
            ) from None

    def fit_beforehand(self) -> None:
        """Fit each effect and each pair while nobody asks for anything; in a thread of its own."""
        for names in self.session.beforehand():
            while self.asking and not self._ended.wait(_PAUSE):
                pass
            if self._ended.is_set():
                return
            with self.lock, suppress(ExploreError):  # said where somebody asks for it
                self.session.view(names)

    def server_close(self) -> None:
        """Free the port, and end what is fitted meanwhile."""
        self._ended.set()
        super().server_close()

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.server_address[1]}{self.root}"

    @property
    def root(self) -> str:
        """The path that all of the page is below."""
        return f"/{self._secret}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say in one line what went wrong with a connection; one that the browser ended is none."""
        error = sys.exc_info()[1]
        if not isinstance(error, ConnectionError):
            print(f"explore: {type(error).__name__}: {error}", file=sys.stderr)


class _Handler(BaseHTTPRequestHandler):
    server: ExploreServer
    timeout = _SILENCE

    def do_GET(self) -> None:
        """Answer one request."""
        root = self.server.root
        if not hmac.compare_digest(self.path[: len(root)].encode(), root.encode()):
            self._send(403, _TEXT, "open the whole address that `smallwheel explore` printed")
            return
        parts = urlsplit(self.path[len(root) - 1 :])
        pages = {"/": self._page, "/view": self._view, "/without": self._without,
                 "/model.yaml": self._model, "/learn.html": self._learn}  # fmt: skip
        if parts.path == "/progress":
            done, needed = self.server.session.progress
            self._send(200, _JSON, json.dumps({"done": done, "needed": needed}))
        elif parts.path not in pages:
            self._send(404, _TEXT, f"no page '{parts.path}'")
        else:
            self.server.asking.add(threading.get_ident())
            try:
                with self.server.lock:
                    pages[parts.path](*self._asked(parts.query))
            except ExploreError as error:
                self._send(400, _TEXT, str(error))
            finally:
                self.server.asking.discard(threading.get_ident())

    def _asked(self, query: str) -> tuple[tuple[str, ...], str, str]:
        """Effects, setting and run of a query; those to begin with where it is empty."""
        session = self.server.session
        found = parse_qs(query, keep_blank_values=True)
        for key in found:
            if key not in _KEYS:
                raise ExploreError(f"no setting '{key}': there is {', '.join(_KEYS)}")
        names = found.get("effects", [] if found else list(session.chosen))
        over = session.setting(found.get("over", [None])[-1])
        return session.choose(names), over, found.get("run", [""])[-1]

    def _page(self, names: tuple[str, ...], over: str, run: str) -> None:
        session = self.server.session
        data = SessionData(session, over)
        with suppress(ExploreError):  # the page asks for it once more, and says why
            session.view(names)
        views = [
            v for v in dict.fromkeys([*session.steps(), *session.fitted]) if v in session.fitted
        ]
        effects = data.page(views, names, served=True)
        page = diagnosis_page(
            session.document, effects=effects, measurements=session.measurements, served=True
        )
        self._send(200, _HTML, page.html().encode("utf-8", "replace"))

    def _view(self, names: tuple[str, ...], over: str, run: str) -> None:
        session = self.server.session
        try:
            found = SessionData(session, over).view(session.view(names))
        except ExploreError as error:  # what was asked for is fine, the fit is not
            found = {"problem": str(error)}
        self._send(200, _JSON, json.dumps(drawn(found), allow_nan=False))

    def _without(self, names: tuple[str, ...], over: str, run: str) -> None:
        lines = self.server.session.without_run(names, run)
        self._send(200, _JSON, json.dumps({"lines": lines}))

    def _model(self, names: tuple[str, ...], over: str, run: str) -> None:
        session = self.server.session
        stem = re.sub(r"[^\w-]+", "_", "_".join([Path(session.measurements.source).stem, *names]))
        # Letters beyond ASCII in the form of RFC 5987; the plain name is for who cannot read that.
        plain = re.sub(r"[^\x21-\x7e]", "_", stem)
        disposition = f"attachment; filename=\"{plain}.yaml\"; filename*=UTF-8''{quote(stem)}.yaml"
        headers = {"Content-Disposition": disposition}
        self._send(200, "application/yaml", session.model_file(names), headers)

    def _learn(self, names: tuple[str, ...], over: str, run: str) -> None:
        self._send(200, _HTML, learnt_page(self.server.session.learnt()).html())

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
            "Referrer-Policy": "no-referrer",  # the address is a secret
            **(headers or {}),
        }.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Keep quiet: the terminal is for what matters."""
