"""`imucald set-mount`: activate a known mount."""

from __future__ import annotations

import argparse
import math

from imucald.commands.orders import add_target, give

ANGLES = ("roll", "pitch", "yaw")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `set-mount`."""
    add_target(
        parser,
        "The angles are the mount angles that 'imucald status' shows. The state is 'restored' "
        "until the drive confirms the mount. 'imucald status' shows a ± that is a little larger "
        "than --within, because it adds the effect of load and springs.",
        "\n\n  imucald set-mount 14.1 28.5 -10.5 --within 1 --hold",
    )
    for name in ANGLES:
        parser.add_argument(name, type=float, metavar=name.upper(), help=f"{name} [deg]")
    deviation = parser.add_mutually_exclusive_group(required=True)
    deviation.add_argument(
        "--within",
        metavar="DEG",
        help=(
            "uncertainty of the mount (95 %%), as the ± of 'imucald status': one number, or "
            "three with commas about the vehicle's forward, left and up axis"
        ),
    )
    deviation.add_argument(
        "--std",
        metavar="DEG",
        help=("uncertainty of the mount as one standard deviation, half of --within"),
    )
    parser.add_argument(
        "--hold", action="store_true", help="hold this mount: the daemon does not change it"
    )


def run(options: argparse.Namespace) -> int:
    """Send the order to the daemon."""
    from imucald.config.calibration import KnownMount
    from imucald.core.errors import ImucaldError
    from imucald.core.typed import Document, typed
    from imucald.mount.mount_words import SD_95

    name, text = ("--std", options.std) if options.within is None else ("--within", options.within)
    try:
        given = [float(part) for part in text.split(",")]
    except ValueError:
        given = []
    if len(given) not in (1, 3) or not all(0.0 < x < math.inf for x in given):
        form = "one number above 0, or three about x,y,z such as 0.3,0.3,0.5"
        raise ImucaldError(f"{name} takes {form} (here: {text})")
    if options.within is not None:
        given = [x / SD_95 for x in given]
    mount = {f"{name}_deg": getattr(options, name) for name in ANGLES}
    mount |= {"std_deg": given[0] if len(given) == 1 else given, "hold": options.hold}
    # the daemon's own texts are shorter
    typed(mount, KnownMount, Document("set-mount", {}, "the mount"))
    return give(options, "set-mount", mount=mount)
