"""`imucald monitor --web`: the monitor as a web page, only for this machine.

The server reads the daemon's status socket once per second, keeps its history for the charts, and
answers GET requests on 127.0.0.1. The page accepts no orders. A page of another site cannot read
the data: the host name in the request must be the name of this machine (against DNS rebinding), and
other origins are not allowed.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import socket
import time
from collections import deque
from collections.abc import Awaitable, Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import asdict

from imucald.commands.monitor_view import LiveEvent, asked_events, input_health, live_events
from imucald.commands.status_view import is_stale, no_answer, wrong_now
from imucald.core.errors import ImucaldError, LinkError
from imucald.core.libraries import how_to_install
from imucald.core.text import reached_states
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import (
    CONVENTION,
    VEHICLE_AXES,
    angle_cells,
    angles_line,
    driving_left,
    is_trouble,
    judged_std,
    left_out_words,
    percent,
    plus_minus,
    reasons,
    sent_words,
    target_words,
)
from imucald.report.drawing import STYLE, known_rotation, view_drawings
from imucald.runtime.flow import flow
from imucald.service.asking import ask, content, understood
from imucald.service.recent_history import KEPT
from imucald.service.status import since

if TYPE_CHECKING:
    from aiohttp import web

ADDRESS = "127.0.0.1"
PERIOD_S = 1.0
CONNECTIONS_MAX = 32
ASK_S = 2.0
"""Longest time for a connection to send its first request [s]."""
KEEP_S = 5.0
"""Longest time until the next request on the same connection [s]."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; connect-src 'self'; "
    "style-src 'unsafe-inline'; script-src 'self'; img-src data:",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class LiveState:
    """The content of the page: the newest status, the history, the events."""

    def __init__(self, note: str = "") -> None:
        self._note = note
        self._status: dict[str, Any] | None = None
        self._trouble = ""
        self._last: float | None = None
        self._events: list[LiveEvent] = []
        self._columns: list[str] = []
        self._rows: deque[list[Any]] = deque(maxlen=KEPT)

    def update(
        self, status: dict[str, Any], now: float, logged: Sequence[Mapping[str, Any]] = ()
    ) -> None:
        """Process a status and the log of the daemon at wall clock `now` [s]."""
        before, self._status = self._status, status
        try:
            self._events = live_events(status, now, logged)
            self.page(math.inf)
        except BaseException:
            self._status = before
            raise
        self._trouble, self._last = "", now

    @property
    def newest(self) -> float:
        """Time of day of the newest row of the history [s]."""
        return float(self._rows[-1][0]) if self._rows else -math.inf

    def add_history(self, found: Mapping[str, Any]) -> None:
        """Add rows to the history. found: answer of the daemon to `history`: names of the columns,
        and the rows that are newer than `newest`."""
        self._columns = list(found["columns"])
        self._rows.extend(found["rows"])

    def fail(self, error: Exception) -> None:
        """Register that the daemon did not answer."""
        self._trouble = no_answer(error, self._last)

    def page(self, since: float = -math.inf) -> dict[str, Any]:
        """Return the data of the page for JSON. since: only history rows after this time [s]."""
        status = self._status
        if status is None:
            return {"trouble": self._trouble or "no answer yet"}
        mount, stale = status["mount"], is_stale(status, self._trouble)
        rotation = known_rotation(mount)
        return {
            "trouble": self._trouble,
            "note": self._note,
            "state": status["state"],
            "flow": asdict(flow(status)),
            "stale": stale,
            "version": status["version"],
            "channel": status["link"]["channel"],
            "link": status["link"]["state"],
            "vehicle": status["vehicle"],
            "uptime_s": status["uptime_s"],
            "reached": [] if status["state"] == "restored" else reached_states(status),
            "now": "" if self._trouble else wrong_now(status),
            "angles": angles_line(mount),
            "sits": mount.get("sits"),
            "steep": mount.get("steep"),
            "mirrored": mount.get("mirrored"),
            "sent": sent_words(status.get("correction")),
            "convention": CONVENTION,
            "mount": [_angle(status, i) for i in range(len(ANGLES))],
            "progress": _progress(status.get("progress"), stale),
            "reasons": [
                {"who": who, "text": text}
                for who, text in reasons(status["waiting_for"])
                if not is_trouble(text) and not stale
            ],
            "inputs": [_input(status, c, row) for c, row in status["signals"].items()],
            "rejected": status["frames"]["rejected"],
            "left_out": left_out_words(status["details"]),
            "frames": {
                "used": status["frames"]["used"], "given_out": status["frames_given_out"],
                "lost": status["link"]["lost"], "late": status["link"].get("late", 0),
                "conflicts": status["link"]["conflicts"],
                "not_sent": sum(status["link"]["send_errors"].values()),
            },
            "events": [
                {"at": e.clock, "t": e.at, "kind": e.kind, "text": e.text}
                for e in self._events
            ],
            "views": [] if rotation is None else view_drawings(rotation),
            "drawing_style": STYLE,
            "history": {
                "columns": self._columns, "rows": [row for row in self._rows if row[0] > since],
            },
        }  # fmt: skip


def _angle(status: Mapping[str, Any], i: int) -> dict[str, Any]:
    """Return a row of the page: one angle with its ±, and the ± about one axis with its target."""
    mount, name, axis = status["mount"], ANGLES[i], "xyz"[i]
    value, spread = angle_cells(mount, name)
    std = judged_std(mount, axis)
    words, is_reached = target_words(status, axis)
    return {
        "name": name, "value": value, "spread": spread,
        "turn": VEHICLE_AXES[i], "left": plus_minus(std),
        "target": words, "reached": is_reached and not is_stale(status),
    }  # fmt: skip


def _progress(progress: Mapping[str, Any] | None, stale: bool) -> dict[str, Any] | None:
    if progress is None:
        return None
    gates = [
        {
            **gate,
            "percent": percent(gate["share"]),
            "left": "" if stale else driving_left(gate["left_s"]),
        }
        for gate in progress["gates"]
    ]
    return {"goal": progress["goal"], "gates": gates}


def _input(status: Mapping[str, Any], channel: str, row: Mapping[str, Any]) -> dict[str, Any]:
    words, style = input_health(status, channel, row["rate_hz"])
    return {
        "name": channel,
        "rate": row["rate_hz"],
        "samples": row["samples"],
        "health": words,
        "good": style == "green" and not is_stale(status),
        "bad": style not in ("green", "dim"),
    }


def serve(path: Path, port: int, is_over: Callable[[], bool], note: str) -> None:
    """Serve the page until Ctrl-C or until `is_over` is true. Raises ImucaldError."""
    try:
        import aiohttp  # noqa: F401 - an extra: without it there is a remedy to report
    except ImportError:
        text = f"--web needs aiohttp: {how_to_install('live')}"
        raise ImucaldError(text) from None
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_serve(path, port, is_over, LiveState(note)))


async def _serve(path: Path, port: int, is_over: Callable[[], bool], state: LiveState) -> None:
    from aiohttp import web

    bounded = Connections()
    runner = web.AppRunner(application(state, bounded), access_log=None, keepalive_timeout=KEEP_S)
    await runner.setup()
    assert runner.server is not None
    bounded.bound(runner.server)
    try:
        try:
            await web.TCPSite(runner, ADDRESS, port).start()
        except OSError as error:
            reason = error.strerror or error
            text = f"{ADDRESS}:{port} cannot be opened: {reason}; give another port (--web PORT)"
            raise ImucaldError(text) from None
        _, real_port = runner.addresses[0][:2]
        print(f"http://{ADDRESS}:{real_port}   Ctrl-C ends", flush=True)
        tunnel = f"ssh -L {real_port}:{ADDRESS}:{real_port} {socket.gethostname()}"
        print(f"from another machine: {tunnel}, then open the same address there", flush=True)
        while not is_over():
            await _ask(path, state)
            await asyncio.sleep(PERIOD_S)
    finally:
        await runner.cleanup()


async def _ask(path: Path, state: LiveState) -> None:
    try:
        status = content(path, "status", await asyncio.to_thread(ask, path, "status"))
        logged = await asyncio.to_thread(asked_events, path)
        with understood(path):
            state.update(status, time.time(), logged)
    except LinkError as error:
        state.fail(error)
        return
    with contextlib.suppress(LinkError, ValueError, LookupError):  # an older daemon has no history
        history = await asyncio.to_thread(ask, path, f"history {state.newest}")
        state.add_history(json.loads(history))


class Connections:
    """Limits the number of connections of an aiohttp server.

    A connection that sends no complete request is closed after `ASK_S`. If there are more than
    `CONNECTIONS_MAX` connections, such a connection is closed earlier.
    """

    def __init__(self) -> None:
        self._open: dict[web.RequestHandler, asyncio.TimerHandle] = {}  # oldest first
        self._answered: set[web.RequestHandler] = set()

    def bound(self, server: web.Server) -> None:
        """Attach to a server that has no connection yet."""
        made, lost = server.connection_made, server.connection_lost

        def connection_made(handler: web.RequestHandler, transport: asyncio.Transport) -> None:
            made(handler, transport)
            if len(self._open) >= CONNECTIONS_MAX:
                others = (one for one in self._open if one not in self._answered)
                self._cut(next(others, next(iter(self._open))))
            timer = asyncio.get_running_loop().call_later(ASK_S, self._cut, handler)
            self._open[handler] = timer

        def connection_lost(handler: web.RequestHandler, error: BaseException | None) -> None:
            self._forget(handler)
            lost(handler, error)

        vars(server).update(connection_made=connection_made, connection_lost=connection_lost)

    def has_asked(self, handler: web.RequestHandler) -> None:
        """Register a complete request. The server's own time limit applies to the next request."""
        if handler in self._open:
            self._answered.add(handler)
            self._open[handler].cancel()
            timer = asyncio.get_running_loop().call_later(KEEP_S + ASK_S, self._cut, handler)
            self._open[handler] = timer

    def _cut(self, handler: web.RequestHandler) -> None:
        self._forget(handler)
        if handler.transport is not None:
            handler.transport.abort()

    def _forget(self, handler: web.RequestHandler) -> None:
        self._answered.discard(handler)
        if timer := self._open.pop(handler, None):
            timer.cancel()


def application(state: LiveState, connections: Connections | None = None) -> web.Application:
    """Return the web server. Its only paths are `/`, `/monitor.js` and `/live`; all are
    read-only."""
    from aiohttp import web

    pages = resources.files("imucald.report") / "templates"

    @web.middleware
    async def guarded(
        request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        if connections is not None:
            connections.has_asked(request.protocol)
        host = request.host.rpartition(":")[0] or request.host
        if host not in (ADDRESS, "localhost"):
            raise web.HTTPForbidden(text="this page is for this machine only\n")
        response = await handler(request)
        response.headers.update(HEADERS)
        return response

    async def page(_: web.Request) -> web.Response:
        text = (pages / "monitor.html").read_text("utf-8")
        text = text.replace("/* page.css */", (pages / "page.css").read_text("utf-8"))
        return web.Response(text=text, content_type="text/html")

    async def script(_: web.Request) -> web.Response:
        text = (pages / "monitor.js").read_text("utf-8")
        return web.Response(text=text, content_type="text/javascript")

    async def live(request: web.Request) -> web.Response:
        return web.json_response(state.page(since(request.query.get("since", ""))))

    app = web.Application(middlewares=[guarded])
    app.router.add_get("/", page)
    app.router.add_get("/monitor.js", script)
    app.router.add_get("/live", live)
    return app
