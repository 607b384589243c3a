"""What is read from many drives together, against truth that the test makes itself."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucald.commands.fleet_read import print_analysis
from imucald.fleet import page
from imucald.fleet.analysis.analyse import analysed
from imucald.fleet.analysis.components import between_drives, between_vehicles
from imucald.fleet.analysis.segments import candidates
from imucald.fleet.analysis_columns import ANALYSIS
from imucald.fleet.reading import present_mounts
from imucald.fleet.tables import table_of

CROWN = 0.37
Rows = dict[str, list[dict[str, Any]]]


def columns_of(
    vehicles: int = 40,
    drives: int = 5,
    std: float = 0.1,
    body: float = 0.2,
    spread: float = 0.3,
    seed: int = 1,
    centre: Rotation | None = None,
    offset: Callable[[int, int], tuple[float, float, float]] = lambda *_: (0.0, 0.0, 0.0),
    crown: float = 0.0,
    **more: Callable[[int, int], object],
) -> dict[str, list[Any]]:
    """Columns of `drives`; offset: what a vehicle's sensor is turned by in a drive [deg]."""
    rng = np.random.default_rng(seed)
    centre = centre or Rotation.from_euler("ZYX", (30.0, -5.0, 170.0), degrees=True)
    rows = []
    for v in range(vehicles):
        own = rng.normal(0.0, spread, 3)
        for d in range(drives):
            error = rng.normal(0.0, body, 3) + rng.normal(0.0, std, 3) + np.array([crown, 0, 0])
            e = Rotation.from_rotvec(error, degrees=True)
            turned = Rotation.from_rotvec(own + np.array(offset(v, d)), degrees=True)
            x, y, z, w = (e * turned * centre).as_quat()
            row: dict[str, Any] = {
                "log_key": f"{v}-{d}", "vehicle": f"v{v:04}", "vehicle_type": "van",
                "sensor_serial": None, "sensor_batch": None, "firmware": None,
                "start": 1e9 + d, "end": 1e9 + d + 0.5, "date": None,
                "state": "fine", "first_usable_s": 60.0,
                "q_w": w, "q_x": x, "q_y": y, "q_z": z, "crown_std_deg": CROWN,
                "driving_side": "right", "waiting_roll": None, "waiting_pitch": None,
                "waiting_yaw": None, "causes": "[]",
                "cov_xx_deg2": std**2 + CROWN**2, "cov_yy_deg2": std**2, "cov_zz_deg2": std**2,
                "cov_xy_deg2": 0.0, "cov_xz_deg2": 0.0, "cov_yz_deg2": 0.0,
            }  # fmt: skip
            rows.append(row | {name: of(v, d) for name, of in more.items()})
    return {name: [row[name] for row in rows] for name in rows[0]}


def found(tables: Rows, name: str) -> list[dict[str, Any]]:
    rows = tables[f"analysis/{name}"]
    return [row for row in rows if row["found"]] if name == "remounts" else rows


def test_a_fleet_without_faults_shows_none() -> None:
    tables = analysed(columns_of(sensor_batch=lambda v, _: f"B{v % 4}"))
    assert found(tables, "remounts") == []
    assert tables["analysis/outliers"] == []
    assert {row["verdict"] for row in tables["analysis/groups"]} == {"ok"}
    assert len(tables["analysis/vehicles"]) == len(tables["analysis/segments"]) == 40


def test_a_remount_is_found_between_the_right_drives() -> None:
    def offset(v: int, d: int) -> tuple[float, float, float]:
        return (0.0, 2.0, 0.0) if v == 7 and d >= 3 else (0.0, 0.0, 0.0)

    usable_at_last = {"state": lambda _, d: "usable" if d == 4 else "fine"}
    tables = analysed(columns_of(offset=offset, **usable_at_last))
    (row,) = found(tables, "remounts")
    assert (row["vehicle"], row["before_log_key"], row["after_log_key"]) == ("v0007", "7-2", "7-3")
    assert row["d_y_deg"] == pytest.approx(2.0, abs=0.6)
    assert row["p"] < row["q"] < 0.05
    segments = [s for s in tables["analysis/segments"] if s["vehicle"] == "v0007"]
    assert [s["drives"] for s in segments] == [3, 2]
    assert [s["last_state"] for s in segments] == ["fine", "usable"]
    (vehicle,) = [v for v in tables["analysis/vehicles"] if v["vehicle"] == "v0007"]
    assert vehicle["segments"] == 2
    assert vehicle["weight_y"] == 1.0, "a sensor that was moved is not shrunk to its type"


@pytest.mark.parametrize(
    ("vehicles", "turn", "answer"),
    [
        (1, 30.0, "not known: too few drives: 1 of the 3 pairs"),
        (2, 30.0, "not known: too few drives: 2 of the 3 pairs"),
        (3, 30.0, "1\n  v0000 between 2001-09-09 01:46 and 2001-09-09 01:46: x +30."),
        (3, 0.0, "none\n"),
    ],
)
def test_remounts_are_not_denied_where_the_drives_are_too_few_to_find_one(
    vehicles: int, turn: float, answer: str, capsys: pytest.CaptureFixture[str]
) -> None:
    columns = columns_of(vehicles, 2, offset=lambda v, d: (turn * (v == 0 and d == 1), 0.0, 0.0))
    rows = analysed(columns)
    print_analysis({name: table_of(name, rows[name], ANALYSIS[name]) for name in ANALYSIS})
    text = capsys.readouterr().out
    assert f"moves of sensors: {answer}" in text


def printed(rows: Rows, capsys: pytest.CaptureFixture[str]) -> str:
    print_analysis({name: table_of(name, rows[name], ANALYSIS[name]) for name in ANALYSIS})
    return " ".join(capsys.readouterr().out.split())


def test_drives_that_overlap_in_time_have_no_order_and_so_no_move_between_them(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Every drive has the same start, as `simulate` had."""

    def turn(_: int, d: int) -> tuple[float, float, float]:
        return (30.0 * (d % 2), 0.0, 0.0)

    same = {"start": lambda *_: 1.6e9, "end": lambda *_: 1.6e9 + 600.0}
    rows = analysed(columns_of(2, 5, offset=turn, **same))
    assert found(rows, "remounts") == []
    assert [v["drives_unordered"] for v in rows["analysis/vehicles"]] == [4, 4]
    text = printed(rows, capsys)
    assert "moves of sensors: not known: too few drives: 0 of the 3 pairs" in text
    assert "8 drives without an order in time (v0000, v0001): overlapping an earlier" in text
    for vehicle in rows["analysis/vehicles"]:  # the mean of both mounts is off by up to 18 deg
        assert vehicle["ci95_x_deg"] > 18.0


def test_a_move_after_drives_that_overlap_is_found_and_none_among_them() -> None:
    """The first two of five drives overlap; v0 moves before the fourth, v1 between those two."""

    def offset(v: int, d: int) -> tuple[float, float, float]:
        return (0.0, 3.0 * ((v == 0 and d >= 3) or (v == 1 and d >= 1)), 0.0)

    end = {"end": lambda v, d: 1e9 + d + (1.2 if d == 0 and v < 2 else 0.5)}
    rows = found(analysed(columns_of(offset=offset, **end)), "remounts")
    assert [(r["vehicle"], r["after_log_key"]) for r in rows] == [("v0000", "0-3")]


@pytest.mark.parametrize(("date", "moves"), [("2026-05-0{}", 1), ("2026-05-01", 0), (None, 0)])
def test_drives_without_a_clock_are_in_order_by_the_day_of_their_path_alone(
    date: str | None, moves: int
) -> None:
    def offset(v: int, d: int) -> tuple[float, float, float]:
        return (0.0, 3.0 * (v == 3 and d >= 2), 0.0)

    none = {"start": lambda *_: None, "end": lambda *_: None}
    columns = columns_of(
        offset=offset, **none, date=lambda _, d: date and date.format(9 - d)
    )  # the table's order is another one than that of the days
    rows = found(analysed(columns), "remounts")
    assert [(r["before_log_key"], r["after_log_key"]) for r in rows] == [("3-2", "3-1")] * moves


SHIFT_IN = {"vehicle": "v0003", "log_key": "3-2", "time": 1e9 + 2.2, "t_s": 396.0}
TURN = {"d_x_deg": 0.1, "d_y_deg": 3.0, "d_z_deg": -0.1}


@pytest.mark.parametrize("state", ["fine", "suspect"])
def test_a_move_within_a_drive_is_one_move_of_that_drive_at_its_time(
    state: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """state: at the end of the drive, whose mount is not known while it is suspect."""

    def offset(v: int, d: int) -> tuple[float, float, float]:
        return (0.0, 3.0 * (v == 3 and d >= 2), 0.0)

    at_end = {"state": lambda v, d: state if (v, d) == (3, 2) else "fine"}
    rows = analysed(columns_of(offset=offset, **at_end), shifts=[SHIFT_IN | TURN])
    (row,) = found(rows, "remounts")
    assert (row["before_log_key"], row["after_log_key"]) == ("3-2", "3-2")
    assert (row["before"], row["after"], row["found_s"]) == (1e9 + 2, 1e9 + 2.2, 396.0)
    (mount,) = [
        m
        for m in present_mounts(
            *(rows[f"analysis/{n}"] for n in ("vehicles", "segments", "remounts"))
        )
        if m["vehicle"] == "v0003"
    ]
    assert (mount["moves"], mount["segment"]) == (1, 1)
    text = printed(rows, capsys)
    when = "within the drive of 2001-09-09 01:46, found after 6:36"
    assert f"moves of sensors: 1 v0003 {when}: x +0.10, y +3.00, z -0.10 deg" in text


def test_a_move_in_a_vehicles_only_drive_is_reported() -> None:
    rows = analysed(
        columns_of(1, 1), shifts=[SHIFT_IN | TURN | {"log_key": "0-0", "vehicle": "v0000"}]
    )
    assert len(found(rows, "remounts")) == 1
    assert len(rows["analysis/segments"]) == 1


def test_an_angle_of_a_type_that_two_vehicles_do_not_show_is_stated_not_to_be_known(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = analysed(columns_of(2, 2, offset=lambda v, _: (0.0, 0.0, 40.0 * v)))
    (kind,) = rows["analysis/types"]
    assert kind["ci95_z_deg"] > 180.0
    print_analysis({name: table_of(name, rows[name], ANALYSIS[name]) for name in ANALYSIS})
    text = capsys.readouterr().out
    line = next(row for row in text.splitlines() if row.startswith(f"{kind['vehicle_type']} "))
    assert "not known" in line
    assert f"{kind['ci95_z_deg']:.2f}" not in line
    assert f"{kind['tau_z_deg']:.2f}" not in line
    assert line.split()[-1] == "-", "a column of numbers holds numbers or a dash"
    assert line.split()[3:9] == ["not", "known"] * 3, "roll, pitch and yaw of no common mount"
    assert f"no common mount for {kind['vehicle_type']}: the" in " ".join(text.split())
    assert not page._pictures({**dict.fromkeys(("groups", "never_usable"), ()), "types": [kind],
                               "vehicles": rows["analysis/vehicles"]})["vehicles"]  # fmt: skip


def test_a_type_with_one_vehicle_has_no_spread_between_vehicles_and_no_complaint(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = analysed(columns_of(1, 3))
    (kind,) = rows["analysis/types"]
    print_analysis({name: table_of(name, rows[name], ANALYSIS[name]) for name in ANALYSIS})
    text = capsys.readouterr().out
    line = next(row for row in text.splitlines() if row.startswith(f"{kind['vehicle_type']} "))
    assert line.split()[-1] == "-"
    assert "no common mount" not in text


def test_the_headline_of_the_page_says_where_moves_are_not_known() -> None:
    assert page._headline([], [], [], [], are_moves_known=True) == "Nothing stands out"
    unknown = page._headline([], [], [], [], are_moves_known=False)
    assert unknown == "Nothing stands out; moves between drives are not known"
    found = page._headline([{"vehicle": "a"}], [], [], [], are_moves_known=False)
    assert found == "1 move of a sensor (a)"


def test_the_interval_of_an_angle_is_its_own_where_the_sensor_is_turned_by_90_deg() -> None:
    centre = Rotation.from_euler("ZYX", (90.0, 0.0, 0.0), degrees=True)
    (kind,) = analysed(columns_of(12, 3, centre=centre))["analysis/types"]
    assert kind["ci95_x_deg"] > 1.5 * kind["ci95_y_deg"]  # the crown of the road
    assert kind["ci95_pitch_deg"] == pytest.approx(kind["ci95_x_deg"], rel=0.02)
    assert kind["ci95_roll_deg"] == pytest.approx(kind["ci95_y_deg"], rel=0.1)
    assert kind["ci95_yaw_deg"] == pytest.approx(kind["ci95_z_deg"], rel=0.02)


def test_an_outlier_is_judged_by_the_others_and_widens_nothing() -> None:
    def offset(v: int, d: int) -> tuple[float, float, float]:
        return (0.0, 0.0, 40.0) if v in (3, 4) else (0.0, 0.0, 0.0)

    # one in twenty found is allowed to be false: this seed shows none
    tables = analysed(columns_of(offset=offset, seed=2))
    assert [row["vehicle"] for row in tables["analysis/outliers"]] == ["v0003", "v0004"]
    (kind,) = tables["analysis/types"]
    assert kind["tau_z_deg"] == pytest.approx(0.3, abs=0.12)
    assert kind["tau_low_z_deg"] < 0.3 < kind["tau_high_z_deg"]
    weights = {v["vehicle"]: v["weight_z"] for v in tables["analysis/vehicles"]}
    assert weights["v0003"] == 1.0
    assert weights["v0010"] < 1.0


def test_a_bad_batch_is_found_and_is_no_heap_of_outliers() -> None:
    def offset(v: int, d: int) -> tuple[float, float, float]:
        return (0.0, 1.5, 0.0) if v % 8 == 3 else (0.0, 0.0, 0.0)

    columns = columns_of(80, offset=offset, sensor_batch=lambda v, _: f"B{v % 8}")
    tables = analysed(columns)
    bad = [row for row in tables["analysis/groups"] if row["verdict"] == "bad"]
    assert [row["name"] for row in bad] == ["B3"]
    assert abs(bad[0]["d_y_deg"] - 1.5) < bad[0]["ci95_y_deg"] < 0.4
    assert tables["analysis/outliers"] == []
    (kind,) = tables["analysis/types"]
    assert abs(kind["tau_y_deg"] - 0.3) < 0.12, "the batch is not in the spread of the type"


def test_a_small_batch_is_not_judged() -> None:
    tables = analysed(columns_of(40, sensor_batch=lambda v, _: "few" if v < 4 else "many"))
    verdicts = {row["name"]: row["verdict"] for row in tables["analysis/groups"]}
    assert verdicts == {"few": "too few", "many": "ok"}


def test_the_crown_counts_once_and_is_not_divided_by_the_vehicles() -> None:
    few, many = (analysed(columns_of(n))["analysis/types"][0] for n in (10, 160))
    assert many["ci95_y_deg"] < 0.5 * few["ci95_y_deg"]
    assert many["ci95_x_deg"] > 1.96 * CROWN
    assert many["ci95_x_deg"] == pytest.approx(
        math.hypot(1.96 * CROWN, many["ci95_y_deg"]), rel=0.1
    )


def test_the_crown_is_in_no_difference() -> None:
    """A road that leans all vehicles alike by three deviations makes nobody an outlier."""
    flat, leaning = (analysed(columns_of(crown=c)) for c in (0.0, 3.0 * CROWN))
    assert leaning["analysis/outliers"] == flat["analysis/outliers"] == []
    for one, other in zip(*(t["analysis/vehicles"] for t in (flat, leaning)), strict=True):
        assert one["p"] == pytest.approx(other["p"], abs=0.05)


def test_angles_anywhere_give_the_same_findings() -> None:
    """Rotation vectors about the type: upside down or turned by 180 deg is nothing special."""
    places = [(0.0, 0.0, 0.0), (180.0, 0.0, 0.0), (-90.0, 89.9, 0.0), (45.0, 10.0, 180.0)]
    spreads = []
    for angles in places:
        centre = Rotation.from_euler("ZYX", angles, degrees=True)
        (kind,) = analysed(columns_of(centre=centre))["analysis/types"]
        spreads.append([kind[f"tau_{a}_deg"] for a in "xyz"])
        mount = Rotation.from_quat([kind[f"q_{n}"] for n in "xyzw"])
        assert np.degrees((mount * centre.inv()).magnitude()) < 0.3
    assert np.ptp(spreads, axis=0).max() < 0.01


def test_one_vehicle_with_one_drive_is_no_error() -> None:
    tables = analysed(columns_of(1, 1))
    (vehicle,) = tables["analysis/vehicles"]
    assert (vehicle["drives"], vehicle["outlier"]) == (1, False)
    assert math.isfinite(vehicle["shrunk_q_w"])


def test_no_known_drive_at_all_is_no_error() -> None:
    columns = columns_of(2, 2)
    columns["state"] = ["levelled"] * 4
    columns["first_usable_s"] = [None] * 4
    columns["waiting_yaw"] = ["waiting for more driving to be usable (+-3.2 deg)"] * 4
    tables = analysed(columns)
    assert tables["analysis/vehicles"] == []
    (row,) = tables["analysis/never_usable"]
    assert (row["drives"], row["vehicles"], row["share"]) == (4, 2, 1.0)
    assert row["reason"] == "waiting for more driving to be usable"


def test_a_fault_of_many_vehicles_of_a_type_is_design_and_of_one_is_not() -> None:
    columns = columns_of(
        90,
        2,
        vehicle_type=lambda v, _: f"type-{v % 3}",
        causes=lambda v, _: json.dumps(
            ["accel stuck"] * (v % 3 == 1 and v < 30) + ["gyro saturated"] * (v == 5)
        ),
    )
    rows = analysed(columns)["analysis/causes"]
    verdicts = {(r["vehicle_type"], r["cause"]): r["verdict"] for r in rows}
    assert verdicts == {
        ("type-1", "accel stuck"): "design",
        ("type-2", "gyro saturated"): "single vehicles",
    }
    columns["causes"], columns["diagnosed"] = ["[]"] * 180, columns["causes"]
    of_diagnosis = analysed(columns)["analysis/causes"]
    assert [(r["cause"], r["verdict"]) for r in of_diagnosis] == [
        ("diagnosed: accel stuck", "design"),
        ("diagnosed: gyro saturated", "single vehicles"),
    ]
    (row,) = [r for r in rows if r["cause"] == "accel stuck"]
    assert (row["vehicles_with"], row["vehicles"]) == (10, 30)
    assert 0.0 < row["rate_shrunk"] <= 1 / 3


def test_shrinkage_brings_vehicles_nearer_to_the_truth() -> None:
    """Few, poor drives beside a narrow type: the type tells more than the vehicle's own."""
    rng_free = columns_of(60, 1, std=0.8, spread=0.2)
    tables = analysed(rng_free)
    raw, shrunk = (
        [_angle(v, prefix) for v in tables["analysis/vehicles"]] for prefix in ("", "shrunk_")
    )
    # the truth of every vehicle is within 0.2 deg per axis of the type's mount
    assert np.mean(np.square(shrunk)) < 0.5 * np.mean(np.square(raw))


def _angle(row: dict[str, Any], prefix: str) -> float:
    mount = Rotation.from_quat([row[f"{prefix}q_{n}"] for n in "xyzw"])
    centre = Rotation.from_euler("ZYX", (30.0, -5.0, 170.0), degrees=True)
    return float(np.degrees((mount * centre.inv()).magnitude()))


def test_components_hold_the_truth_in_95_of_100() -> None:
    """Intervals of variances by profile likelihood, on values that NumPy draws."""
    rng = np.random.default_rng(4)
    held = {"D": 0, "T": 0}
    for _ in range(200):
        segment = np.repeat(np.arange(30), 4)
        P = rng.uniform(0.01, 0.2, 120)
        y = rng.normal(0.0, 1.0, 30)[segment] + rng.normal(0.0, np.sqrt(0.09 + P))
        found_D = between_drives(y, P, segment)
        held["D"] += found_D.low <= 0.09 <= found_D.high
        V = rng.uniform(0.01, 0.2, 40)
        found_T = between_vehicles(rng.normal(5.0, np.sqrt(0.16 + V)), V)
        held["T"] += found_T.low <= 0.16 <= found_T.high
    # 190 of 200 expected, standard deviation 3
    assert all(180 <= n <= 199 for n in held.values()), held


def test_cuts_are_where_the_partition_is_best_of_all() -> None:
    """Against trying every partition of a short history."""
    rng = np.random.default_rng(8)
    n = 9
    penalty = chi2.isf(0.05 / (n - 1), 3)
    for _ in range(20):
        e = rng.normal(0.0, 1.0, (n, 3)) + np.where(
            np.arange(n)[:, None] >= rng.integers(2, 8), 3, 0
        )
        W = np.eye(3)[None] * rng.uniform(0.5, 2.0, (n, 1, 1))

        def cost(cuts: list[int], e: Any = e, W: Any = W) -> float:
            total = penalty * len(cuts)
            for a, b in zip([0, *cuts], [*cuts, n], strict=True):
                w = W[a:b, 0, 0]
                mean = (w[:, None] * e[a:b]).sum(axis=0) / w.sum()
                total += float((w[:, None] * (e[a:b] - mean) ** 2).sum())
            return total

        partitions = [[i for i in range(1, n) if code >> i & 1] for code in range(0, 2**n, 2)]
        assert cost(candidates(e, W, np.ones(n, dtype=bool))) == pytest.approx(
            min(map(cost, partitions))
        )
