"""Access to a result's tables, one per rate. The only join is `resample`.

What turns tables into others is loaded when it is asked for: a replay needs none of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from imucald.api.columns import EVENTS, HISTORY, RAW, Columns
from imucald.core.errors import ImucaldError

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa


class NamedTables:
    """Tables by name, for Arrow, numpy, pandas and polars."""

    tables: Mapping[str, Columns]

    def _named(self, table: str) -> Columns:
        found = self.tables.get(table)
        if found is None:
            there = ", ".join(self.tables) or "none"
            raise ImucaldError(f"there is no table {table!r} here; there are: {there}")
        return found

    def arrow(self, table: str) -> pa.Table:
        """A table by its name, for Arrow. Needs pyarrow (the extra "arrow").

        Raises ImucaldError where there is no such table.
        """
        from imucald.api.files.table_file import axes_of  # noqa: PLC0415
        from imucald.api.interchange import to_arrow  # noqa: PLC0415

        return to_arrow(self._named(table), {"table": table, "axes": axes_of(table)})

    def numpy(self, table: str) -> dict[str, NDArray[Any]]:
        """A table as arrays (N,) by column; `time` is in microseconds since 1970 (int64).

        Numbers that are not known are NaN. Raises ImucaldError where there is no such table.
        """
        return {name: array.copy() for name, array in self._named(table).as_dict().items()}

    def to_pandas(self, table: str) -> pd.DataFrame:
        """A table for pandas (the extra "pandas"); `attrs["units"]` has the unit by column."""
        from imucald.api.interchange import to_pandas  # noqa: PLC0415

        return to_pandas(self._named(table), table)

    def to_polars(self, table: str) -> pl.DataFrame:
        """A table for polars (the extra "polars")."""
        from imucald.api.interchange import to_polars  # noqa: PLC0415

        return to_polars(self._named(table))


class TableAccess(NamedTables):
    """Tables by name: "accel", "gyro", "mag", "parallel/NAME" corrected to vehicle axes,
    "raw/CHANNEL" as the sensors gave them, "history" (1 Hz) and "events".

    Every table begins with `t_s`, seconds from the log's first frame, which never run backwards,
    and `time`, what the log says (UTC). The unit is in a column's name, in its field's metadata,
    and, under "imucald" and "PANDAS_ATTRS", in the schema's.
    """

    @property
    def accel(self) -> pa.Table:
        """Specific force in vehicle axes [m/s^2], before it is rounded into frames.

        Columns t_s, time, accel_x_mps2, accel_y_mps2, accel_z_mps2 (null: no correction in force,
        or the sensor was not fit to be used) and quality (0 not available, 1 restored, 2 usable,
        3 fine, 4 suspect), a row for each sample.
        """
        return self.arrow("accel")

    @property
    def gyro(self) -> pa.Table:
        """Angular rate in vehicle axes [rad/s]: t_s, time, gyro_x_radps, ..., quality."""
        return self.arrow("gyro")

    @property
    def mag(self) -> pa.Table:
        """Magnetic field in vehicle axes [T]: t_s, time, mag_x_tesla, ..., quality."""
        return self.arrow("mag")

    def raw(self, quantity: str) -> pa.Table:
        """Samples of a quantity as they came, checked and in SI; a sensor's in its own axes.

        quantity: "accel", "gyro", "mag", "speed", "wheel_speeds", "steering", "yaw_rate",
        "lateral_accel", "longitudinal_accel", "reverse", "brake", "heading", "temperature" or
        "parallel/NAME". Columns t_s, time, then raw_... with the unit in the name.
        """
        return self.arrow(f"{RAW}{quantity}")

    @property
    def history(self) -> pa.Table:
        """The estimate once a second.

        t_s, time, state, usable (whether a correction was in force), roll_deg, pitch_deg, yaw_deg,
        q_w, q_x, q_y, q_z, and cov_xx_deg2, cov_xy_deg2, ..., cov_zz_deg2 as in `MountResult`;
        null before there is an estimate.
        """
        return self.arrow(HISTORY)

    @property
    def events(self) -> pa.Table:
        """What happened: t_s, time, kind, text, and d_x_deg, d_y_deg, d_z_deg of a shift.

        Kinds: "state" (text: the new one), "shift" (the mount was moved; d_*: the rotation vector
        about the vehicle's axes, once a good mount is found after it), "evidence" (a change that
        lies within its own 95 % interval: nothing shows that the mount was moved), "contradiction"
        (between signals), "segment" (a hole, or the clock was set), "sensor_fault". Times are when
        it was noticed.
        """
        return self.arrow(EVENTS)

    def resample(self, rate_hz: float, quantities: Sequence[str] = ("accel", "gyro")) -> pa.Table:
        """Join tables of samples at one rate. This is the only join there is.

        rate_hz: of the rows, at whole multiples of 1/rate_hz after the log's first frame. A table
        with more samples than that is averaged with a Hann window of four periods, so that what is
        faster than half the rate is damped by 31 dB and more; one with fewer is interpolated
        linearly. In holes (no two samples within 2.5 of the table's usual periods) it is null.
        quantities: tables of numbers, such as "accel" or "raw/speed".

        Returns t_s and the tables' columns. Raises ImucaldError for a rate that is not positive,
        or a table that cannot be joined.
        """
        from imucald.api.interchange import to_arrow  # noqa: PLC0415
        from imucald.api.resampling import resampled  # noqa: PLC0415

        tables = {name: self._named(name) for name in quantities}
        return to_arrow(resampled(tables, rate_hz), {"table": "resampled", "rate_hz": rate_hz})
