"""Results as files: what is written comes back to the last bit, and others read it with units."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from replayed_drive import config, drive, log

import imucald

pytestmark = pytest.mark.slow

asammdf = pytest.importorskip("asammdf")
duckdb = pytest.importorskip("duckdb")
pandas = pytest.importorskip("pandas")
polars = pytest.importorskip("polars")
parquet = pytest.importorskip("pyarrow.parquet")
arrow_csv = pytest.importorskip("pyarrow.csv")
mcap_reader = pytest.importorskip("mcap.reader")
ros2_decoder = pytest.importorskip("mcap_ros2.decoder")

FORMATS = ("parquet", "csv", "mf4", "mcap")
EVERYTHING = ("accel", "gyro", "raw", "history", "events")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """The drive in every format."""
    found = tmp_path_factory.mktemp("written")
    for ending in FORMATS:
        drive().write(found / f"drive.{ending}", EVERYTHING)
    return found


@pytest.mark.parametrize("ending", FORMATS)
def test_what_is_written_comes_back_to_the_last_bit(folder, ending):
    again = imucald.open_result(folder / f"drive.{ending}")
    assert list(again.tables) == list(drive().tables)
    assert len(again.tables) > 10
    for name, table in drive().tables.items():
        assert again.tables[name].columns == table.columns
        for mine, theirs in zip(table.arrays, again.tables[name].arrays, strict=True):
            assert theirs.dtype == mine.dtype
            assert np.array_equal(mine, theirs, equal_nan=mine.dtype.kind == "f")
    assert np.isnan(drive().tables["accel"].arrays[2]).any(), "nulls are among what came back"
    assert again.to_dict() == drive().to_dict()
    assert np.array_equal(again.mount.covariance_deg2, drive().mount.covariance_deg2)
    assert again.mount.quaternion_wxyz == drive().mount.quaternion_wxyz
    assert (again.logs, again.start, again.end) == (drive().logs, drive().start, drive().end)


def test_times_in_csv_need_no_time_zone_database(tmp_path, monkeypatch):
    """A container has none, and Arrow then refuses to write a time with a time zone."""
    schemas = []

    def opened(path, schema):
        schemas.append(schema)
        return writer(path, schema)

    writer = arrow_csv.CSVWriter
    monkeypatch.setattr(arrow_csv, "CSVWriter", opened)
    (file,) = [f for f in drive().write(tmp_path / "a.csv", "accel") if f.suffix == ".csv"]
    assert [str(field.type) for field in schemas[0]][:2] == ["double", "string"]
    head, first = file.read_text().splitlines()[:2]
    assert head.split(",")[1] == '"time"'
    assert first.split(",")[1].startswith('"2020-09-13 12:26:40')
    assert first.split(",")[1].endswith('Z"')


def test_pandas_reads_parquet_with_units(folder):
    frame = pandas.read_parquet(folder / "drive.accel.parquet")
    assert frame.attrs["units"]["accel_x_mps2"] == "m/s^2"
    assert frame.attrs["units"]["t_s"] == "s"
    mine = drive().to_pandas("accel")
    assert mine.attrs == frame.attrs
    assert np.array_equal(frame["accel_y_mps2"], mine["accel_y_mps2"], equal_nan=True)
    assert (frame["time"] == mine["time"]).all()
    assert str(frame["time"].iloc[0]).startswith("2020-09-13 12:26:40")


def test_polars_reads_parquet_with_units(folder):
    file = folder / "drive.gyro.parquet"
    keys = polars.read_parquet_metadata(file)
    assert json.loads(keys["imucald"])["units"]["gyro_z_radps"] == "rad/s"
    frame = polars.read_parquet(file)
    assert frame.equals(drive().to_polars("gyro"))
    assert frame["gyro_x_radps"].null_count() == (drive().tables["gyro"]["quality"] == 0).sum() > 0


def one_row(query: str):
    (row,) = duckdb.sql(query).fetchall()
    return row


def test_duckdb_reads_parquet_with_units(folder):
    file = str(folder / "drive.accel.parquet")
    count, low = one_row(f"select count(accel_z_mps2), min(t_s) from '{file}' where quality >= 2")
    table = drive().tables["accel"]
    good = table["quality"] >= 2
    assert (count, low) == (np.count_nonzero(good), table["t_s"][good][0])
    (text,) = one_row(
        f"select decode(value) from parquet_kv_metadata('{file}') where decode(key) = 'imucald'"
    )
    content = json.loads(text)
    assert content["units"]["accel_z_mps2"] == "m/s^2"
    assert content["drive"]["result"] == drive().to_dict()


def test_arrow_has_the_unit_at_the_field(folder):
    for schema in (parquet.read_schema(folder / "drive.accel.parquet"), drive().accel.schema):
        assert schema.field("accel_x_mps2").metadata == {b"unit": b"m/s^2"}
        assert str(schema.field("time").type) == "timestamp[us, tz=UTC]"


def test_every_unit_stands_in_the_name_of_its_column():
    suffix = {"m/s^2": "mps2", "rad/s": "radps", "T": "tesla", "m/s": "mps", "rad": "rad",
              "deg": "deg", "deg^2": "deg2", "s": "s", "degC": "degc"}  # fmt: skip
    seen = set()
    for table in drive().tables.values():
        for column in table.columns:
            if column.unit not in ("", "1"):
                assert column.name.rpartition("_")[2] == suffix[column.unit]
                seen.add(column.unit)
    assert seen >= {"m/s^2", "rad/s", "m/s", "rad", "deg", "deg^2", "s"}


@pytest.mark.parametrize("name", ["accel", "gyro", "history", "raw_speed"])
def test_plotjuggler_finds_flat_numeric_columns_and_a_time(folder, name):
    """Its plug-in takes numbers, booleans and time stamps; a nested column shifts the others."""
    schema = parquet.read_schema(folder / f"drive.{name}.parquet")
    kinds = {str(field.type) for field in schema}
    assert kinds <= {"double", "int8", "bool", "string", "timestamp[us, tz=UTC]"}
    assert schema.names[0] == "t_s"
    assert np.all(np.diff(parquet.read_table(folder / f"drive.{name}.parquet")["t_s"]) >= 0)


def test_asammdf_reads_mf4_with_units_and_one_group_a_rate(folder):
    with asammdf.MDF(folder / "drive.mf4") as mdf:
        signal = mdf.get("accel_x_mps2")
        assert signal.unit == "m/s^2"
        table = drive().tables["accel"]
        assert np.array_equal(signal.timestamps, table["t_s"])
        assert np.array_equal(signal.samples, table["accel_x_mps2"], equal_nan=True)
        assert mdf.get("cov_xx_deg2").unit == "deg^2"
        assert len(mdf.get("cov_xx_deg2").samples) == len(drive().tables["history"])
        seconds = (mdf.header.start_time - drive().start).total_seconds()
        assert abs(seconds) < 1e-3


def decoded(path: Path) -> dict[str, list]:
    """Schema, message and content of each topic, by another library than the one that wrote."""
    found: dict[str, list] = {}
    factory = ros2_decoder.DecoderFactory()
    with path.open("rb") as file:
        reader = mcap_reader.make_reader(file, decoder_factories=[factory])
        assert reader.get_header().profile == "ros2"
        for schema, channel, message, content in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((schema, channel, message, content))
    return found


def test_mcap_has_the_messages_that_ros_2_knows(folder):
    found = decoded(folder / "drive.mcap")
    assert {channel.message_encoding for (_, channel, _, _), *_ in found.values()} == {"cdr"}
    schema, _, message, imu = found["/imu/data"][-1]
    assert (schema.name, schema.encoding) == ("sensor_msgs/msg/Imu", "ros2msg")
    assert imu.header.frame_id == "vehicle"
    assert imu.orientation_covariance[0] == -1
    accel, gyro = drive().tables["accel"], drive().tables["gyro"]
    good = np.flatnonzero(accel["quality"])
    assert len(found["/imu/data"]) == len(good)
    assert imu.linear_acceleration.z == accel["accel_z_mps2"][good[-1]]
    stamp = imu.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == message.log_time == accel["time"][good[-1]] * 1000
    nearest = np.argmin(np.abs(gyro["t_s"] - accel["t_s"][good[-1]]))
    assert imu.angular_velocity.x == gyro["gyro_x_radps"][nearest]
    for covariance in (imu.linear_acceleration_covariance, imu.angular_velocity_covariance):
        assert (np.linalg.eigvalsh(np.reshape(covariance, (3, 3))) > 0.0).all()
    _, _, _, raw = found["/imu/data_raw"][-1]
    assert raw.header.frame_id == "sensor"
    assert raw.linear_acceleration.x == drive().tables["raw/accel"].arrays[2][-1]
    (one,) = found["/tf_static"]
    assert one[0].name == "tf2_msgs/msg/TFMessage"
    assert "durability: 1" in one[1].metadata["offered_qos_profiles"], "transient_local"
    (turn,) = one[3].transforms
    assert (turn.header.frame_id, turn.child_frame_id) == ("vehicle", "sensor")
    q = turn.transform.rotation
    assert (q.w, q.x, q.y, q.z) == pytest.approx(drive().mount.quaternion_wxyz)
    schema, _, _, line = found["/rosout"][0]
    assert (schema.name, line.name) == ("rcl_interfaces/msg/Log", "imucald")
    assert line.msg.endswith(drive().tables["events"]["text"][0])
    assert found["/mount"][-1][3].yaw_deg == drive().tables["history"]["yaw_deg"][-1]


def test_mcap_without_gyroscope_or_history_says_what_is_not_known(tmp_path):
    drive().write(tmp_path / "a.mcap", "accel")
    found = decoded(tmp_path / "a.mcap")
    assert set(found) == {"/imu/accel", "/imu/data"}
    _, _, _, imu = found["/imu/data"][-1]
    assert imu.angular_velocity_covariance[0] == -1
    noise = np.reshape(imu.linear_acceleration_covariance, (3, 3))
    assert np.count_nonzero(noise) == 3, "of the samples alone"


def test_mcap_of_json_of_an_earlier_version_is_reported(tmp_path):
    writer = pytest.importorskip("mcap.writer").Writer(str(tmp_path / "old.mcap"))
    writer.start()
    schema = writer.register_schema("sensor_msgs/Imu", "jsonschema", b"{}")
    writer.add_message(writer.register_channel("/imu/accel", "json", schema), 1, b"{}", 1)
    columns = [[c.name, c.unit, c.kind] for c in drive().tables["accel"].columns]
    about = {"version": 1, "imucald": "0.2.0", "tables": {"accel": columns}, "drive": {}}
    text = json.dumps({**about, "topics": {"accel": "/imu/accel"}})
    writer.add_metadata("imucald", {"imucald": text})
    writer.finish()
    with pytest.raises(
        imucald.ImucaldError,
        match=r"old\.mcap: an earlier version of imucald wrote its messages as JSON",
    ):
        imucald.open_result(tmp_path / "old.mcap")


def test_one_table_is_just_that_file(tmp_path):
    (file,) = drive().write(tmp_path / "a.parquet", "gyro")
    assert file == tmp_path / "a.parquet"
    assert [p.name for p in tmp_path.iterdir()] == ["a.parquet"]
    assert list(imucald.open_result(file).tables) == ["gyro"]


def test_all_but_raw_is_written_where_nothing_else_is_stated(tmp_path):
    drive().write(tmp_path / "a.parquet")
    names = {p.name for p in tmp_path.iterdir()}
    assert names == {f"a.{n}.parquet" for n in ("accel", "gyro", "history", "events")}
    with pytest.raises(imucald.ImucaldError, match=r"no table 'akkel'.*accel"):
        drive().write(tmp_path / "b.parquet", ["akkel"])


@pytest.mark.parametrize("ending", FORMATS)
def test_a_failure_leaves_nothing_and_what_was_there_stays(tmp_path, ending):
    bad = tmp_path / "bad.log"
    bad.write_bytes(log().read_bytes()[:3_000_000] + b"no frame\n")
    out = tmp_path / f"out.{ending}"
    out.write_text("before")
    with pytest.raises(imucald.LogError, match=r"bad\.log"):
        imucald.stream(config(), bad, strict=True).write(out, "accel")
    assert out.read_text() == "before"
    assert {p.name for p in tmp_path.iterdir()} == {"bad.log", out.name}


@pytest.mark.parametrize("name", ["a.xlsx", "nowhere/a.parquet", "nowhere/a.mcap"])
def test_a_file_that_cannot_be_written_is_reported(tmp_path, name):
    with pytest.raises(imucald.ImucaldError, match=r"a\."):
        drive().write(tmp_path / name)


@pytest.mark.parametrize("ending", FORMATS)
def test_a_file_that_is_not_ours_is_reported_with_its_name(tmp_path, ending, folder):
    path = tmp_path / f"other.{ending}"
    with pytest.raises(imucald.ImucaldError, match=f"other.{ending}"):
        imucald.open_result(path)
    path.write_bytes(b"something else")
    with pytest.raises(imucald.ImucaldError, match=f"other.{ending}"):
        imucald.open_result(path)
    whole = (
        folder / f"drive.accel.{ending}"
        if ending in ("parquet", "csv")
        else folder / f"drive.{ending}"
    ).read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(imucald.ImucaldError, match=f"other.{ending}"):
        imucald.open_result(path)


@pytest.mark.parametrize("kind", [b"##CN", b"##CG", b"##DG"])
def test_an_mf4_whose_list_leads_back_into_itself_is_reported(tmp_path, folder, kind):
    whole = bytearray((folder / "drive.mf4").read_bytes())
    at = whole.index(kind)
    whole[at + 24 : at + 32] = at.to_bytes(8, "little")
    path = tmp_path / "other.mf4"
    path.write_bytes(whole)
    with pytest.raises(imucald.ImucaldError, match="two links point to the block"):
        imucald.open_result(path)


@pytest.mark.parametrize(("library", "extra", "use"), [
    ("pyarrow", "arrow", lambda d, _: d.accel),
    ("pyarrow", "arrow", lambda d, p: d.write(p / "a.parquet")),
    ("pandas", "pandas", lambda d, _: d.to_pandas("accel")),
    ("polars", "polars", lambda d, _: d.to_polars("accel")),
    ("asammdf", "mf4", lambda d, p: d.write(p / "a.mf4")),
    ("mcap", "mcap", lambda d, p: d.write(p / "a.mcap")),
    ("rosbags", "mcap", lambda d, p: d.write(p / "a.mcap")),
    ("matplotlib", "report", lambda d, _: d.plot.mount()),
])  # fmt: skip
def test_a_missing_library_is_reported_with_the_extra_that_brings_it(
    monkeypatch, tmp_path, library, extra, use
):
    _hide(monkeypatch, library)
    with pytest.raises(imucald.ImucaldError, match=rf"needs {library}.*'\.\[{extra}\]'"):
        use(drive(), tmp_path)
    assert not list(tmp_path.iterdir())


def _hide(monkeypatch, library):
    for name in [m for m in sys.modules if m.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)

    class Finder:
        def find_spec(self, name, path=None, target=None):
            if name.partition(".")[0] == library:
                raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(sys, "meta_path", [Finder(), *sys.meta_path])
