"""Access to the tables of a result, one table per rate. Only `resample` joins tables.

The modules that convert tables are imported at the first use, because a replay does not need them.
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
    """Tables by name, with conversion to Arrow, numpy, pandas and polars."""

    tables: Mapping[str, Columns]

    def _named(self, table: str) -> Columns:
        found = self.tables.get(table)
        if found is None:
            there = ", ".join(self.tables) or "none"
            raise ImucaldError(f"there is no table {table!r} here; there are: {there}")
        return found

    def arrow(self, table: str) -> pa.Table:
        """Return the table with this name as an Arrow table. Needs pyarrow (the extra "arrow").

        Raises ImucaldError if there is no such table.
        """
        from imucald.api.files.table_file import axes_of  # noqa: PLC0415
        from imucald.api.interchange import to_arrow  # noqa: PLC0415

        return to_arrow(self._named(table), {"table": table, "axes": axes_of(table)})

    def numpy(self, table: str) -> dict[str, NDArray[Any]]:
        """Return a table as arrays (N,) by column; `time` is in microseconds since 1970 (int64).

        Unknown numbers are NaN. Raises ImucaldError if there is no such table.
        """
        return {name: array.copy() for name, array in self._named(table).as_dict().items()}

    def to_pandas(self, table: str) -> pd.DataFrame:
        """Return a table as a pandas frame (needs the extra "pandas").

        `attrs["units"]` has the unit by column. Raises ImucaldError if there is no such table.
        """
        from imucald.api.interchange import to_pandas  # noqa: PLC0415

        return to_pandas(self._named(table), table)

    def to_polars(self, table: str) -> pl.DataFrame:
        """Return a table as a polars frame (needs the extra "polars")."""
        from imucald.api.interchange import to_polars  # noqa: PLC0415

        return to_polars(self._named(table))


class TableAccess(NamedTables):
    """The tables of a drive by name.

    "accel", "gyro", "mag", "parallel/NAME": samples corrected to vehicle axes. "raw/CHANNEL":
    samples as the sensors sent them. "history": the estimate at 1 Hz. "events": the events.

    Every table begins with the columns `t_s` and `time`. `t_s` is in seconds since the log's first
    frame and never decreases. `time` is the time that the log states (UTC). The name of each column
    contains its unit. The unit is also in the metadata of the Arrow field, and in the metadata of
    the schema under "imucald" and "PANDAS_ATTRS".
    """

    @property
    def accel(self) -> pa.Table:
        """Specific force in vehicle axes [m/s^2], before rounding to the resolution of frames.

        One row per sample. Columns: t_s, time, accel_x_mps2, accel_y_mps2, accel_z_mps2, quality.
        Force is null while no correction is active or while the sensor is faulty. quality: 0 not
        available, 1 restored, 2 usable, 3 fine, 4 suspect.
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
        """Return the raw samples of a quantity: checked, in SI units, in the sensor's own axes.

        quantity: "accel", "gyro", "mag", "speed", "wheel_speeds", "steering", "yaw_rate",
        "lateral_accel", "longitudinal_accel", "reverse", "brake", "heading", "temperature" or
        "parallel/NAME". Columns: t_s, time, then raw_... with the unit in the name.
        """
        return self.arrow(f"{RAW}{quantity}")

    @property
    def history(self) -> pa.Table:
        """The estimate once per second.

        Columns: t_s, time, state, usable (whether a correction was active), roll_deg, pitch_deg,
        yaw_deg, q_w, q_x, q_y, q_z, and cov_xx_deg2, cov_xy_deg2, ..., cov_zz_deg2 as in
        `MountResult`. Values are null before the first estimate.
        """
        return self.arrow(HISTORY)

    @property
    def events(self) -> pa.Table:
        """The events. Columns: t_s, time, kind, text, and d_x_deg, d_y_deg, d_z_deg for a shift.

        Kinds of events: "state" (text: the new state). "shift": the sensor was moved; d_* is the
        rotation vector of the move about the vehicle's axes, which is known as soon as the new
        mount is good. "evidence": a change of the estimate within its own 95 % interval, so the
        sensor was probably not moved. "contradiction": signals contradict each other. "segment": a
        gap in the log, or the clock was set. "sensor_fault": a sensor is faulty. The time is the
        time of detection.
        """
        return self.arrow(EVENTS)

    def resample(self, rate_hz: float, quantities: Sequence[str] = ("accel", "gyro")) -> pa.Table:
        """Join tables of samples at one rate. No other method joins tables.

        rate_hz: the rate of the new rows. Their times are whole multiples of 1/rate_hz after the
        log's first frame. A table with a higher rate is averaged with a Hann window of four
        periods, which damps frequencies above half the new rate by at least 31 dB. A table with a
        lower rate is interpolated linearly. Values in gaps (longer than 2.5 usual periods of the
        table) are null. quantities: tables of numbers, such as "accel" or "raw/speed".

        Returns t_s and the tables' columns. Raises ImucaldError if the rate is not positive or a
        table cannot be joined.
        """
        from imucald.api.interchange import to_arrow  # noqa: PLC0415
        from imucald.api.resampling import resampled  # noqa: PLC0415

        tables = {name: self._named(name) for name in quantities}
        return to_arrow(resampled(tables, rate_hz), {"table": "resampled", "rate_hz": rate_hz})
