"""`imucald demo`: show how a calibration converges, without hardware."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from imucald.commands.monitor import add_web_argument
from imucald.commands.options import add_mount
from imucald.core.errors import ConfigError

DEFAULT_MINUTES = 6.0
"""Length of the drive [min]. All angles converge during this drive. The user waits about fifteen
seconds."""
QUICK_MINUTES = 2.5
FASTEST = 20.0
"""Fastest speed, as a multiple of real time. A busy machine cannot reach it."""
MAX_MINUTES = 120.0
"""Longest drive [min]. The user waits some minutes for it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `demo`."""
    parser.add_argument(
        "--seed",
        type=int,
        default=1,
        metavar="N",
        help="number from which car, road, drive and mount are drawn (default: 1)",
    )
    parser.add_argument(
        "--minutes",
        type=float,
        metavar="M",
        help=f"length of the drive (default: {DEFAULT_MINUTES:g})",
    )
    add_mount(parser)
    parser.add_argument(
        "--quick", action="store_true", help=f"simulate only {QUICK_MINUTES:g} minutes"
    )
    parser.add_argument(
        "--live",
        action="store_true",
        help="run in real time: a simulated bus, the real daemon and its monitor",
    )
    add_web_argument(parser)
    parser.add_argument(
        "--interface",
        default="virtual",
        help="with --live: python-can interface of the bus, such as udp_multicast, which other "
        "programs can join (default: virtual)",
    )
    parser.add_argument("--channel", help="with --live: channel of this interface")
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        metavar="X",
        help=("with --live: run X times as fast as real time"),
    )
    parser.add_argument(
        "--svg", type=Path, metavar="FILE", help="write the last picture and the result as SVG"
    )


def _command(options: argparse.Namespace, minutes: float) -> str:
    mount = f" --mount {options.mount}" if options.mount else ""
    return f"imucald demo --seed {options.seed} --minutes {minutes:g}{mount} --svg FILE"


def run(options: argparse.Namespace) -> int:
    """Run the drive, show it, and compare the estimate with the truth. Return 0 if the estimate
    became usable."""
    from imucald.commands.files import check_files
    from imucald.commands.terminal import plain_where_needed

    minutes = options.minutes
    if minutes is None:
        minutes = QUICK_MINUTES if options.quick else DEFAULT_MINUTES
    if not 0.1 <= minutes <= MAX_MINUTES:
        raise ConfigError(f"--minutes must be between 0.1 and {MAX_MINUTES:g}")
    plain_where_needed()
    check_files((), (options.svg,))
    if options.live:
        from imucald.commands.demo_live import run_live

        if not 0.1 <= options.speed <= FASTEST:
            raise ConfigError(f"--speed must be between 0.1 and {FASTEST:g}")
        minutes = options.minutes or 30.0
        bus = options.interface, options.channel, options.speed
        run_live(options.seed, minutes, options.mount, *bus, options.web)
        return 0
    return _as_fast_as_it_goes(options, minutes)


def _as_fast_as_it_goes(options: argparse.Namespace, minutes: float) -> int:
    from imucald.commands.demo_drive import Demonstration
    from imucald.commands.demo_picture import (
        LiveView,
        Picture,
        PlainView,
        print_result,
        write_svg,
    )
    from imucald.commands.simulate import chosen_model
    from imucald.simulation.drive import simulate
    from imucald.traffic.drive_encoder import example_config

    model = chosen_model(
        argparse.Namespace(
            seed=options.seed, mount=options.mount, model=None, route=None, shift=[], changes=[]
        )
    )
    began = time.monotonic()
    drive = simulate(model, options.seed, minutes)
    view = LiveView(options.seed) if sys.stdout.isatty() else PlainView(options.seed)
    picture = Picture()
    with Demonstration(drive, example_config()) as demonstration:
        with view:
            for _ in demonstration.run():
                view.show(demonstration)
                picture.note(demonstration)
        waited = time.monotonic() - began
        print_result(demonstration, waited)
        if options.svg:
            write_svg(demonstration, picture, options.svg, _command(options, minutes))
        usable = demonstration.engine.pipeline.first_usable is not None
    return 0 if usable else 1
