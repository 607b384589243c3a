"""`imucald set-mount`: put a mount that is known in force."""

from __future__ import annotations

import argparse
import math

from imucald.commands.orders import add_target, give

ANGLES = ("roll", "pitch", "yaw")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `set-mount`."""
    add_target(
        parser,
        " Angles are those of the sensor in the vehicle, as 'imucald status' shows them. The mount "
        "counts as restored until the drive confirms it. "
        "Example: imucald set-mount 14.1 28.5 -10.5 --std 0.5 --hold",
    )
    for name in ANGLES:
        parser.add_argument(name, type=float, metavar=name.upper(), help=f"{name} [deg]")
    parser.add_argument(
        "--std",
        required=True,
        metavar="DEG",
        help="standard deviation, half of the ± that is shown: one number, or three with commas "
        "about the vehicle's x,y,z axis",
    )
    parser.add_argument("--hold", action="store_true", help="keep it: learn nothing")


def run(options: argparse.Namespace) -> int:
    """Give the order."""
    from imucald.config.calibration import KnownMount
    from imucald.core.errors import ImucaldError
    from imucald.core.locations import Document
    from imucald.core.typed import typed

    try:
        given = [float(part) for part in options.std.split(",")]
    except ValueError:
        given = []
    if len(given) not in (1, 3) or not all(0.0 < std < math.inf for std in given):
        text = "one number above 0, or three about x,y,z such as 0.3,0.3,0.5"
        raise ImucaldError(f"--std takes {text} (here: {options.std})")
    mount = {f"{name}_deg": getattr(options, name) for name in ANGLES}
    mount |= {"std_deg": given[0] if len(given) == 1 else given, "hold": options.hold}
    # the daemon's own words are terser
    typed(mount, KnownMount, Document("set-mount", {}, "the mount"))
    return give(options, "set-mount", mount=mount)
