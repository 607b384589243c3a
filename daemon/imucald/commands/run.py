"""`imucald run`: the live daemon."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from imucald.pipeline import Snapshot


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `run`."""
    parser.add_argument("--config", required=True, type=Path, metavar="FILE", help="configuration")
    parser.add_argument(
        "--database",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="database to use in place of the configuration's (repeat for several)",
    )
    parser.add_argument("--interface", help="python-can interface (default: the configuration's)")
    parser.add_argument("--channel", help="its channel, such as can0")
    parser.add_argument("--seconds", type=float, metavar="S", help="stop by itself after this time")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON at the end")


def run(options: argparse.Namespace) -> int:
    """Run until SIGINT or SIGTERM."""
    import dataclasses
    import signal
    import time

    from imucald.engine import LinkHealth
    from imucald.service.live import Daemon, open_link
    from imucald.session import make_engine, open_config
    from imucald.summary import Counts, as_json, summary

    loaded = open_config(options.config, options.database)
    daemon: Daemon | None = None

    def link_health() -> LinkHealth:
        return daemon.link_health() if daemon is not None else LinkHealth()

    engine = make_engine(loaded, _Announcer().snapshot, link_health)
    link = open_link(
        loaded,
        engine.router.matches,
        engine.output.can_ids,
        options.interface,
        options.channel,
        lambda event: _say(event.text),
    )
    with link:
        daemon = Daemon(engine, link)
        stop = daemon.stop
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: stop())
        _say(f"listening on {link.interface} {link.channel}")
        end = time.monotonic() + options.seconds if options.seconds else float("inf")
        while not daemon.stopping and time.monotonic() < end:
            daemon.step()
    counts = Counts(link.counters.received, engine.router.used, engine.router.rejected)
    result = summary(engine, counts, engine.timebase.now)
    result["link"] = dataclasses.asdict(link.counters)
    if options.json == "-":
        sys.stdout.write(as_json(result))
    elif options.json:
        Path(options.json).write_text(as_json(result), encoding="utf-8")
    _say(f"stopped; state {result['state']}, {engine.sent} frames given out")
    return 0


def _say(text: str) -> None:
    print(f"imucald: {text}", file=sys.stderr, flush=True)


class _Announcer:
    """Says each change of state in one line."""

    def __init__(self) -> None:
        self._state: object = None

    def snapshot(self, snapshot: Snapshot) -> None:
        estimate = snapshot.estimate
        if estimate.state is self._state:
            return
        self._state = estimate.state
        waiting = "; ".join(estimate.waiting_for.values())
        _say(f"{estimate.state.name.lower()} at {snapshot.t:.1f} s" + (waiting and f" ({waiting})"))
