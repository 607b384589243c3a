"""Orders to a running daemon: what they do, over which door, and what is told of them."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest

from imucald import cli
from imucald.commands import orders
from imucald.config.calibration import KnownMount
from imucald.core.rotations import rotation_from_angles
from imucald.runtime.mount_orders import TESTER, OrderError
from imucald.service.asking import ask
from imucald.service.service import Service
from service_bench import Bench, running

ME = "root (pid 7)"
KNOWN = KnownMount(0.0, 0.0, 40.0, 0.5)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def order(service: Service, **request: object) -> dict[str, str]:
    assert service.sockets.control is not None
    return dict(json.loads(ask(service.sockets.control.path, json.dumps(request))))


def yaw(service: Service) -> float | None:
    return service.status()["mount"]["yaw_deg"]


@pytest.mark.parametrize("std", ["0", "-1", "nan", "1,2", "x", "1,1,0"])
def test_a_deviation_that_is_none_is_refused_by_the_options_name(std, capsys):
    assert cli.main(["set-mount", "1", "2", "3", "--std", std]) == 1
    error = capsys.readouterr().err
    assert "--std takes one number above 0, or three" in error
    assert f"(here: {std})" in error


@pytest.mark.parametrize(
    ("given", "std_deg"),
    [(("--std", "0.5"), 0.5), (("--within", "1"), 0.5), (("--within", "1,2,4"), [0.5, 1.0, 2.0])],
)
def test_within_is_the_interval_that_status_shows(given, std_deg, monkeypatch):
    sent = {}
    monkeypatch.setattr(orders, "_give", lambda *_, **order: sent.update(order) or 0)
    assert cli.main(["set-mount", "1", "2", "3", *given]) == 0
    assert sent["mount"]["std_deg"] == std_deg


def test_a_mount_is_stated_with_one_deviation(capsys):
    for given in ((), ("--std", "0.5", "--within", "1")):
        with pytest.raises(SystemExit):
            cli.main(["set-mount", "1", "2", "3", *given])
    assert cli.main(["set-mount", "1", "2", "3", "--within", "0"]) == 1
    assert "--within takes one number above 0, or three" in capsys.readouterr().err


def test_a_reset_forgets_the_learnt_and_the_saved_mount_and_says_who_did_it(bench):
    service = bench.service()
    bench.drive(service)
    service._every_second(time.monotonic())
    with running(service):
        assert "forgotten" in order(service, order="reset")["done"]
        assert service.engine.pipeline.correction is None
        said = f"(by {'root' if os.geteuid() == 0 else f'user {os.geteuid()}'} (pid {os.getpid()}))"
        told = [event for event in service.journal.events if event.text.startswith("reset:")]
        assert [event.text.endswith(said) for event in told] == [True]
        assert abs(told[0].at - time.time()) < 5.0
    assert "reset" in bench.log.getvalue()
    again = bench.service()
    assert again.engine.pipeline.quality == 0
    assert list((bench.folder / "state").glob("*.forgotten.*"))
    again.close()


def test_a_hold_keeps_the_mount_through_a_contradicting_drive_and_a_restart(bench):
    service = bench.service()
    bench.drive(service)
    before = service.engine.pipeline.correction
    service.orders.hold(ME)
    assert service.status()["held"]
    assert service.status()["state"] in {"usable", "fine"}
    assert service.engine.pipeline.correction == before
    bench.another_drive(yaw_deg=60.0)
    bench.drive(service)
    assert service.engine.pipeline.correction == before
    assert service.status()["state"] == "suspect"
    service.close()
    again = bench.service()
    assert again.status()["held"]
    assert again.engine.pipeline.correction.rotation == pytest.approx(before.rotation, abs=1e-12)
    assert "held: nothing is learnt" in bench.log.getvalue()
    again.orders.release(ME)
    bench.drive(again)
    assert abs(yaw(again) - 60.0) < 3.0
    assert not again.status()["held"]
    again.close()


def first_times(service: Service) -> tuple[float | None, float | None]:
    status = service.status()
    return status["first_usable_s"], status["first_fine_s"]


def test_no_order_but_a_reset_moves_the_time_at_which_the_mount_became_usable(bench):
    service = bench.service()
    bench.drive(service)
    bench.drive(service)
    first = first_times(service)
    assert first[0] is not None
    service.orders.hold(ME)
    assert first_times(service) == first
    service.orders.release(ME)
    assert first_times(service) == first
    service.orders.set_mount(KNOWN, ME)
    assert first_times(service) == first
    service.orders.begin(TESTER)
    assert first_times(service) == (None, None)
    assert service.orders.return_to_former(TESTER)
    assert first_times(service) == first
    service.orders.reset(ME)
    assert first_times(service) == (None, None)
    service.close()


def test_a_reload_that_keeps_the_mount_keeps_the_time_at_which_it_became_usable(bench):
    service = bench.service()
    bench.drive(service)
    first = first_times(service)
    service.reload()
    assert first_times(service) == first
    assert first[0] is not None
    service.close()


def test_orders_that_cannot_be_carried_out_say_why_and_change_nothing(bench):
    service = bench.service()
    estimator = service.engine.pipeline.estimator
    with pytest.raises(OrderError, match=r"no mount to hold yet \(state waiting\).*set-mount"):
        service.orders.hold(ME)
    with pytest.raises(OrderError, match="not held"):
        service.orders.release(ME)
    with pytest.raises(OrderError, match="a standard deviation of 20 deg about x is too uncertain"):
        service.orders.set_mount(KnownMount(0.0, 0.0, 0.0, 20.0), ME)
    assert service.engine.pipeline.estimator is estimator
    bench.drive(service)
    service.orders.hold(ME)
    with pytest.raises(OrderError, match="held already"):
        service.orders.hold(ME)
    service.close()


def test_a_known_mount_serves_at_once_as_restored_and_the_drive_takes_over(bench):
    service = bench.service()
    text = service.orders.set_mount(KnownMount(0.0, 0.0, 25.0, 1.0), ME)
    assert "yaw +25 deg" in text
    assert "±2" in text
    assert service.engine.pipeline.quality == 1
    expected = rotation_from_angles(0.0, 0.0, np.radians(25.0)).ravel()
    assert service.engine.pipeline.correction.rotation == pytest.approx(expected)
    assert service.status()["details"]["restored"]["given"] is True
    bench.drive(service)
    assert service.status()["state"] in {"usable", "fine"}
    service.close()


def test_a_known_mount_that_is_held_is_there_after_a_restart_as_it_was_given(bench):
    service = bench.service()
    service.orders.set_mount(KnownMount(0.0, 0.0, 40.0, 0.5, hold=True), ME)
    service.close()
    for _ in range(3):
        again = bench.service()
        assert yaw(again) == pytest.approx(40.0)
        assert again.status()["held"]
        assert again.status()["details"]["restored"]["given"] is True
        std = again.status()["mount"]["std_deg"]["z"]
        assert std == pytest.approx(np.hypot(0.5, 0.15), abs=1e-3), "no vaguer by each restart"
        again.close()


def test_the_configured_mount_serves_from_the_first_frame_and_holds(bench):
    mount = "{roll_deg: 0, pitch_deg: 0, yaw_deg: 40, std_deg: [0.3, 0.3, 0.5], hold: true}"
    bench.edit("accelerometer_bias: 0.02", f"accelerometer_bias: 0.02\n  mount: {mount}")
    service = bench.service()
    assert (service.engine.pipeline.quality, yaw(service)) == (1, pytest.approx(40.0))
    for refused in (
        lambda: service.orders.set_mount(KNOWN, ME),
        lambda: service.orders.release(ME),
    ):
        with pytest.raises(OrderError, match=r"shuttle.yaml states the mount and holds it"):
            refused()
    bench.drive(service)  # of a sensor at 25 deg
    assert yaw(service) == pytest.approx(40.0)
    assert service.status()["state"] == "suspect"
    waiting = service.engine.pipeline.estimator.estimate().waiting_for.values()
    assert not any("imucald release" in text for text in waiting)
    assert "configuration" in service.orders.reset(ME)
    assert (service.engine.pipeline.quality, yaw(service)) == (1, pytest.approx(40.0))
    service.close()


def test_a_hold_by_the_configuration_ends_with_it(bench):
    """One by an order outlives a reload."""
    mount = "{roll_deg: 0, pitch_deg: 0, yaw_deg: 24, std_deg: 0.5, hold: true}"
    bench.edit("accelerometer_bias: 0.02", f"accelerometer_bias: 0.02\n  mount: {mount}")
    service = bench.service()
    assert service.status()["held"]
    bench.edit(", hold: true", "")
    service.reload()
    assert not service.status()["held"]
    service.orders.hold(ME)
    bench.edit("accelerometer_bias: 0.02", "accelerometer_bias: 0.03")
    service.reload()
    assert service.status()["held"]
    waiting = service.engine.pipeline.estimator.estimate().waiting_for.values()
    assert not any("configuration" in text for text in waiting)
    service.close()


def test_a_configured_mount_that_is_not_held_gives_way_to_what_was_learnt_from_it(bench):
    mount = "{roll_deg: 0, pitch_deg: 0, yaw_deg: 24, std_deg: 2}"
    bench.edit("accelerometer_bias: 0.02", f"accelerometer_bias: 0.02\n  mount: {mount}")
    service = bench.service()
    assert yaw(service) == pytest.approx(24.0)
    bench.drive(service)
    learnt = yaw(service)
    assert learnt != pytest.approx(24.0, abs=0.01)
    service.close()
    again = bench.service()
    assert yaw(again) == pytest.approx(learnt, abs=0.5)
    again.close()
    bench.edit("yaw_deg: 24", "yaw_deg: 23")
    other = bench.service()
    assert yaw(other) == pytest.approx(23.0), "another stated mount begins anew"
    other.close()


def test_a_configured_mount_that_is_too_vague_is_refused_with_its_line(bench, capsys):
    mount = "{roll_deg: 0, pitch_deg: 0, yaw_deg: 0, std_deg: 9}"
    bench.edit("accelerometer_bias: 0.02", f"accelerometer_bias: 0.02\n  mount: {mount}")
    run = ["run", "--config", str(bench.config), "--interface", "virtual", "--seconds", "0.01"]
    assert cli.main(run) == 78
    text = capsys.readouterr().err
    assert "calibration.mount.std_deg: 9 deg about x is too uncertain" in text
    assert "below 2.62 deg (±5.24 deg at 95 %)" in text
    assert "shuttle.yaml:" in text


@pytest.mark.parametrize(
    ("roll", "yaw", "words"),
    [
        (180, 0, "turns z down, but 'orientation' says up: z"),
        (0, 180, "turns x back"),
        (30, 40, ""),
    ],
)
def test_a_stated_mount_that_contradicts_the_orientation_is_refused(
    bench, capsys, roll, yaw, words
):
    orientation = "orientation: {up: z, forward: x}"
    bench.edit("estimator: published", "estimator: full")
    bench.edit("accelerometer_bias: 0.02", f"accelerometer_bias: 0.02\n  {orientation}")
    service = bench.service()
    mount = KnownMount(float(roll), 0.0, float(yaw), 0.5)
    if words:
        with pytest.raises(OrderError, match=words):
            service.orders.set_mount(mount, ME)
    else:
        assert "in force" in service.orders.set_mount(mount, ME)
    service.close()
    stated = f"mount: {{roll_deg: {roll}, pitch_deg: 0, yaw_deg: {yaw}, std_deg: 0.5}}"
    bench.edit(orientation, f"{orientation}\n  {stated}")
    assert cli.main(["run", "--check", "--config", str(bench.config)]) == (78 if words else 0)
    text = capsys.readouterr().err
    assert f"calibration.mount: {words}" in text if words else "calibration.mount" not in text


def test_a_reload_keeps_a_hold(bench):
    service = bench.service()
    bench.drive(service)
    service.orders.hold(ME)
    before = service.engine.pipeline.correction
    bench.edit("accelerometer_bias: 0.02", "accelerometer_bias: 0.03")
    service.reload()
    assert service.status()["held"]
    assert service.engine.pipeline.correction.rotation == pytest.approx(before.rotation)
    service.close()


def test_testers_and_root_have_one_calibration_and_a_reset_is_final_for_both(bench):
    service = bench.service()
    bench.drive(service)
    service.orders.begin(TESTER)
    service.orders.reset(ME)
    assert not service.orders.return_to_former(TESTER), "what was reset does not come back"
    bench.drive(service)
    service.orders.begin(TESTER)
    assert service.orders.return_to_former(TESTER)
    assert service.engine.pipeline.quality >= 2
    texts = [event.text for event in service.journal.events if "(by " in event.text]
    assert [text.rpartition("(by ")[2] for text in texts][:2] == [f"{TESTER})", f"{ME})"]
    service.close()


def test_the_commands_reach_a_running_daemon(bench, capsys):
    service = bench.service()
    bench.drive(service)
    asked = ["--socket", str(service.options.status_socket)]
    with running(service):
        assert cli.main(["hold", *asked]) == 0
        assert cli.main(["hold", *asked]) == 1
        assert "held already" in capsys.readouterr().err
        assert cli.main(["release", *asked]) == 0
        given = ["set-mount", "-1.5", "2", "-40", "--std", "0.5", "--hold", *asked]
        assert cli.main(given) == 0
        assert "roll -1.5, pitch +2, yaw -40 deg" in capsys.readouterr().out
        assert yaw(service) == pytest.approx(-40.0, abs=1e-3)
        assert cli.main(["set-mount", "0", "0", "200", "--std", "1", *asked]) == 1
        assert "yaw_deg: must be a number at most 180.0 (here: 200.0)" in capsys.readouterr().err
        assert cli.main(["events", *asked, "-n", "3"]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert len(lines) == 3
        assert any("set-mount: roll -1.5" in line and "pid" in line for line in lines)
        assert cli.main(["reset", *asked]) == 0
    for command in ("reset", "events", "status"):
        assert cli.main([command, *asked]) == 3, "nobody is there any more"
        assert capsys.readouterr().err.startswith("imucald: ")


def test_a_control_socket_that_others_cannot_open_names_sudo(bench, capsys, monkeypatch):
    with running(bench.service()) as service:
        monkeypatch.setattr(os, "access", lambda *_: False)
        assert cli.main(["reset", "--socket", str(service.options.status_socket)]) == 1
    assert "run it as root: sudo" in capsys.readouterr().err


@pytest.mark.parametrize("std", [1e-300, 1e-6, 0.0099])
def test_a_mount_that_is_stated_finer_than_any_is_known_is_refused(tmp_path, std):
    service = Bench(tmp_path).service()
    with pytest.raises(OrderError, match=r"too small for any mount: it must be 0.01 deg"):
        service.orders.set_mount(KnownMount(0.0, 0.0, 40.0, std), "root (pid 7)")
    assert "±0.02" in service.orders.set_mount(KnownMount(0.0, 0.0, 40.0, 0.01), "root (pid 7)")
    service.close()
