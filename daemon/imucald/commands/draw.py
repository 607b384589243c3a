"""`imucald draw`: show the orientation of a sensor from its angles, as a picture and in words."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from imucald.commands.options import allow_negative_numbers, numbers

if TYPE_CHECKING:
    from imucald.core.rotations import Matrix3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `draw`."""
    allow_negative_numbers(parser)
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument(
        "--mount", metavar="R,P,Y", help="roll, pitch and yaw of the sensor in degrees"
    )
    what.add_argument(
        "--quaternion",
        metavar="W,X,Y,Z",
        help="the rotation from sensor to vehicle axes, as 'imucald replay --json' writes it",
    )
    what.add_argument(
        "--axes", action="store_true", help="the vehicle's axes and the signs of the angles"
    )
    parser.add_argument("--out", metavar="FILE.svg", help="write the drawing here")


def run(options: argparse.Namespace) -> int:
    """Describe the orientation of the sensor, and draw it."""
    from imucald.commands.files import with_origin, write_text
    from imucald.commands.terminal import plain_where_needed
    from imucald.core.orientation_words import sits_words, steep_words
    from imucald.core.rotations import angles_from_rotation, quaternion_from_rotation
    from imucald.report.drawing import axes_drawing, drawing

    plain_where_needed()
    if options.axes:
        svg, words = axes_drawing(), "vehicle axes: x forward, y left, z up"
    else:
        R = _rotation(options)
        words = sits_words(R)
        svg = drawing(R, words)
        steep = steep_words(angles_from_rotation(R)[1], quaternion_from_rotation(R))
        words += f"\n{steep}" if steep else ""
    if options.out:
        write_text(options.out, with_origin(svg, _command(options)))
    print(words)
    return 0


def _command(options: argparse.Namespace) -> str:
    name = next(n for n in ("axes", "mount", "quaternion") if getattr(options, n))
    value = getattr(options, name)
    return f"imucald draw --{name}" if value is True else f"imucald draw --{name} {value}"


def _rotation(options: argparse.Namespace) -> Matrix3:
    """Return R_vehicle_from_sensor from angles or quaternion. Raises ConfigError if invalid."""
    import math

    from imucald.core.errors import ConfigError
    from imucald.core.rotations import rotation_from_angles, rotation_from_quaternion

    name, text, wanted = "--quaternion", options.quaternion, 4
    if options.mount:
        name, text, wanted = "--mount", options.mount, 3
    found = numbers(text)
    if len(found) != wanted:
        raise ConfigError(f"{name} must be {wanted} numbers with commas between them, not {text!r}")
    if options.mount:
        roll, pitch, yaw = (math.radians(x) for x in found)
        return rotation_from_angles(roll, pitch, yaw)
    length = math.hypot(*found)
    if not 0.99 < length < 1.01:
        raise ConfigError(f"--quaternion must have length 1; it has length {length:.3g}")
    return rotation_from_quaternion([n / length for n in found])
