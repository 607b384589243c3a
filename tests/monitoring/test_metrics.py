"""Metrics as Prometheus reads them: text, file, over HTTP, dashboard and alert rules."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from imucald import cli
from imucald.core.errors import LinkError
from imucald.service import exposition
from imucald.service.asking import ask
from imucald.service.exposition import bus_of, gathered, merged
from imucald.service.listening import listening_at
from imucald.service.metrics import metrics_text
from imucald.service.metrics_server import CLIENTS_MAX, MetricsServer
from service_bench import Bench, running

MONITORING = Path(__file__).resolve().parents[2] / "monitoring"


@pytest.fixture
def promtool() -> str:
    found = shutil.which("promtool")
    if found is None:
        pytest.skip("not installed: promtool (Debian's package prometheus)")
    return found


def checked(*command: str, text: str | None = None) -> None:
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def metrics_and_status(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, object]]:
    """What a daemon with a finished drive says: metrics and status."""
    bench = Bench(tmp_path_factory.mktemp("daemon"))
    service = bench.service()
    bench.drive(service)
    service.engine.router.rejected['bad "reason"\\\n'] += 2
    with running(service):
        path = service.options.status_socket
        assert path is not None
        return ask(path, "metrics"), json.loads(ask(path, "status"))


def test_a_library_of_prometheus_reads_the_same_numbers_as_the_status_has(metrics_and_status):
    text, status = metrics_and_status
    found = {family.name: family for family in text_string_to_metric_families(text)}
    bus = status["link"]["channel"]
    assert all(s.labels["bus"] == bus for family in found.values() for s in family.samples)
    angles = {s.labels["angle"]: s.value for s in found["imucald_mount_angle_degrees"].samples}
    assert angles == {a: status["mount"][f"{a}_deg"] for a in ("roll", "pitch", "yaw")}
    states = {s.labels["state"]: s.value for s in found["imucald_state"].samples}
    assert [state for state, on in states.items() if on] == [status["state"]]
    samples = {s.labels["channel"]: s.value for s in found["imucald_samples"].samples}
    assert samples["accel"] == status["signals"]["accel"]["samples"]
    (rejected,) = found["imucald_rejected"].samples
    assert (rejected.labels["reason"], rejected.value) == ('bad "reason"\\\n', 2.0)
    assert found["imucald_samples"].type == "counter"
    assert found["imucald_held"].samples[0].value == 0.0
    flows = found["imucald_corrected_frames_flow"].samples[0].value
    assert flows == (status["flow"]["kind"] == "good")


def test_a_good_quality_without_input_is_no_flow_of_corrected_frames(metrics_and_status):
    _, status = metrics_and_status
    for missing, flows in ((False, 1.0), (True, 0.0)):
        health = {**status["health"], "accelerometer_missing": missing}
        now = {**status, "quality": 2, "health": health}
        found = {f.name: f for f in text_string_to_metric_families(metrics_text(now))}
        assert found["imucald_quality"].samples[0].value == 2.0
        assert found["imucald_corrected_frames_flow"].samples[0].value == flows


def test_promtool_finds_no_mistake_in_the_text(metrics_and_status, promtool):
    checked(promtool, "check", "metrics", text=metrics_and_status[0])


def test_several_daemons_stand_in_one_text_with_each_family_once(metrics_and_status, promtool):
    text = metrics_and_status[0]
    bus = str(metrics_and_status[1]["link"]["channel"])
    both = merged([text, text.replace(f'bus="{bus}"', 'bus="can1"')])
    named = [line for line in both.splitlines() if line.startswith("# TYPE")]
    assert len(named) == len(set(named))
    families = list(text_string_to_metric_families(both))
    assert len(families) == len(named)
    assert {s.labels["bus"] for s in families[1].samples} == {bus, "can1"}
    checked(promtool, "check", "metrics", text=both)


@pytest.mark.parametrize("odd", ["\u2028", "\x85", "\x0b", "\x1e"])
def test_a_line_break_that_is_none_of_the_format_stays_in_its_name(odd):
    text = f'# HELP a b.\n# TYPE a gauge\na{{bus="x{odd}y"}} 1\n'
    assert merged([text]) == text


def test_a_daemon_that_does_not_answer_is_down_and_the_others_are_reported(tmp_path):
    bench = Bench(tmp_path)
    with running(bench.service()) as service:
        path = service.options.status_socket
        text = gathered([tmp_path / "can7" / "status.sock", path])
    up = next(f for f in text_string_to_metric_families(text) if f.name == "imucald_up")
    answers = {s.labels["bus"]: s.value for s in up.samples}
    assert answers == {"can7": 0.0, service.link.channel: 1.0}
    assert "imucald_quality" in text
    assert bus_of(Path("/run/user/0/imucald-vcan3.sock")) == "vcan3"


def test_two_daemons_on_one_bus_have_labels_of_their_own(metrics_and_status, promtool, monkeypatch):
    text = metrics_and_status[0]
    monkeypatch.setattr(exposition, "ask", lambda *_: text)
    names = ["back", "can0"]
    both = gathered([Path("/run/imucald", name, "status.sock") for name in names])
    families = {f.name: f for f in text_string_to_metric_families(both)}
    for family in ("imucald_up", "imucald_quality"):
        assert [s.labels["bus"] for s in families[family].samples] == names
    checked(promtool, "check", "metrics", text=both)


def test_the_text_file_is_there_whole_or_not_at_all_and_everybody_may_read_it(tmp_path, capsys):
    bench = Bench(tmp_path)
    target = tmp_path / "collector" / "imucald.prom"
    with running(bench.service()) as service:
        asked = ["metrics", "--socket", str(service.options.status_socket)]
        old = os.umask(0o077)
        try:
            assert cli.main([*asked, "--textfile", str(target)]) == 0
        finally:
            os.umask(old)
        assert stat.S_IMODE(target.stat().st_mode) == 0o644
        assert [p.name for p in target.parent.iterdir()] == ["imucald.prom"]
        families = {f.name for f in text_string_to_metric_families(target.read_text())}
        assert {"imucald_up", "imucald_state", "imucald_alarm"} <= families
        assert cli.main([*asked, "--textfile", "/proc/imucald.prom"]) == 1
        assert "/proc/imucald.prom: cannot be written" in capsys.readouterr().err
        assert cli.main(asked) == 0
        assert "imucald_up" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["pipe", "link", "dangling link", "folder", "socket"])
def test_the_text_file_takes_the_place_of_no_pipe_link_folder_or_socket(tmp_path, capsys, kind):
    target, place = tmp_path / "target.txt", tmp_path / "x.prom"
    target.write_text("old\n")
    with socket.socket(socket.AF_UNIX) as listening:
        match kind:
            case "pipe":
                os.mkfifo(place)
            case "link":
                place.symlink_to(target)
            case "dangling link":
                place.symlink_to(tmp_path / "nothing")
            case "folder":
                place.mkdir()
            case _:
                listening.bind(str(place))
        was = place.lstat()
        asked = ["metrics", "--socket", str(tmp_path / "none.sock"), "--textfile", str(place)]
        assert cli.main(asked) == 1
    assert f"{place}: this is not a regular file" in capsys.readouterr().err
    assert (place.lstat().st_ino, place.lstat().st_mode) == (was.st_ino, was.st_mode)
    assert target.read_text() == "old\n"
    assert {p.name for p in tmp_path.iterdir()} == {"target.txt", "x.prom"}


@contextlib.contextmanager
def served(text: Callable[[], str] = lambda: "x 1\n") -> Iterator[tuple[str, int]]:
    listening = listening_at("127.0.0.1:0")
    host, port = listening.getsockname()
    with MetricsServer(listening, text) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield host, port
        finally:
            server.shutdown()
            thread.join()


def got(address: tuple[str, int], path: str = "/metrics") -> str:
    url = f"http://{address[0]}:{address[1]}{path}"
    with urllib.request.urlopen(url, timeout=5.0) as answer:
        assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
        return str(answer.read().decode())


def test_metrics_over_http_and_nothing_else(tmp_path):
    with served() as address:
        assert got(address) == "x 1\n"
        for path in ("/", "/metrics/../etc/passwd", "/status"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                got(address, path)
        request = urllib.request.Request(f"http://{address[0]}:{address[1]}/metrics", b"reset")
        with pytest.raises(urllib.error.HTTPError, match="501"):
            urllib.request.urlopen(request, timeout=5.0)


def answered(address: tuple[str, int], method: str, host: str | None) -> tuple[int, str, bytes]:
    """Status, stated length and body that a request with this Host gets."""
    connection = http.client.HTTPConnection(*address, timeout=5.0)
    with contextlib.closing(connection):
        connection.putrequest(method, "/metrics", skip_host=True)
        if host is not None:
            connection.putheader("Host", host)
        connection.endheaders()
        answer = connection.getresponse()
        return answer.status, answer.headers["Content-Length"], answer.read()


def test_a_head_is_answered_as_a_get_without_its_text():
    with served() as address:
        assert answered(address, "GET", "localhost") == (200, "4", b"x 1\n")
        assert answered(address, "HEAD", "localhost") == (200, "4", b"")


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8131", "192.0.2.1", "[::", "a b"])
def test_a_page_whose_name_was_made_to_point_here_reads_nothing(host):
    with served() as address:
        status, _, body = answered(address, "GET", host)
        assert status == 403
        assert b"x 1" not in body


@pytest.mark.parametrize("host", ["localhost:8131", "127.0.0.1:8131", "[::1]:8131", "", None])
def test_this_machine_may_call_it_by_its_names(host):
    with served() as address:
        assert answered(address, "GET", host)[0] == 200


def test_one_for_a_network_is_called_by_whatever_name_the_network_has():
    listening = listening_at("0.0.0.0:0")
    with MetricsServer(listening, lambda: "x 1\n") as server:
        assert server.is_named("car7.fleet.example:8131")


@pytest.mark.slow
def test_dripping_and_binary_connections_leave_a_place_after_seconds():
    with served() as address:
        open_ones = []
        for i in range(2 * CLIENTS_MAX):
            connection = socket.create_connection(address, timeout=5.0)
            with contextlib.suppress(OSError):
                connection.sendall(b"GET /me" if i % 2 else os.urandom(2000))
            open_ones.append(connection)
        end = time.monotonic() + 8.0
        while True:
            try:
                assert got(address) == "x 1\n"
                break
            except OSError:
                assert time.monotonic() < end
                time.sleep(0.1)
        for connection in open_ones:
            connection.close()


def test_slow_clients_lock_no_scrape_out():
    """Each sends a header's line often enough to never be idle, and comes back when it is cut."""
    stop = threading.Event()

    def attack(address: tuple[str, int]) -> None:
        slow: list[socket.socket] = []
        while not stop.is_set():
            while len(slow) < 8 * CLIENTS_MAX:
                with contextlib.suppress(OSError):
                    slow.append(socket.create_connection(address, timeout=5.0))
                    slow[-1].sendall(b"GET /metrics HTTP/1.1\r\n")
            for connection in list(slow):
                try:
                    connection.sendall(b"A: b\r\n")
                except OSError:
                    connection.close()
                    slow.remove(connection)
            time.sleep(0.05)
        for connection in slow:
            connection.close()

    with served() as address:
        thread = threading.Thread(target=attack, args=(address,))
        thread.start()
        try:
            time.sleep(0.3)
            answers = []
            for _ in range(20):
                with contextlib.suppress(OSError, http.client.HTTPException):
                    answers.append(got(address))
                time.sleep(0.02)
        finally:
            stop.set()
            thread.join()
    assert len(answers) >= 18


def test_who_has_asked_is_not_cut_off_for_others():
    began, go_on = threading.Event(), threading.Event()

    def text() -> str:
        began.set()
        assert go_on.wait(10.0)
        return "slow 1\n"

    with served(text) as address, contextlib.ExitStack() as closing:
        answers: list[str] = []
        thread = threading.Thread(target=lambda: answers.append(got(address)))
        thread.start()
        assert began.wait(5.0)
        for _ in range(3 * CLIENTS_MAX):
            closing.enter_context(socket.create_connection(address, timeout=5.0))
        go_on.set()
        thread.join()
    assert answers == ["slow 1\n"]


@pytest.mark.parametrize(
    ("address", "why"),
    [("9108", "HOST:PORT"), ("127.0.0.1:", "HOST:PORT"), ("127.0.0.1:99999", "HOST:PORT"),
     ("192.0.2.1:8131", "cannot be served at 192.0.2.1:8131"), ("no.such.invalid:1", "served")],
)  # fmt: skip
def test_an_address_that_cannot_be_had_is_reported_with_its_form(address, why):
    with pytest.raises(LinkError, match=why):
        listening_at(address)


def test_run_serves_metrics_from_a_process_of_its_own_that_ends_with_it(tmp_path):
    bench = Bench(tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "imucald", "run", "--config", str(bench.config)]
    command += ["--interface", "virtual", "--channel", "x", "--status-socket"]
    command += [str(tmp_path / "s"), "--metrics-listen", f"127.0.0.1:{port}"]
    daemon = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        wait_until((tmp_path / "s").exists, 20.0)
        text = got(("127.0.0.1", port))
        assert 'imucald_state{bus="x",state="waiting"} 1' in text
        pid = int(json.loads(ask(tmp_path / "s", "status"))["process"]["pid"])
        assert pid == daemon.pid
        second = subprocess.run(command, capture_output=True, text=True, check=False)
        assert second.returncode == 1
        assert f"127.0.0.1:{port}: Address already in use" in second.stderr
        daemon.send_signal(signal.SIGKILL)
        daemon.wait(5.0)
        wait_until(lambda: not is_open(port), 5.0)
    finally:
        daemon.kill()
        daemon.communicate()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


@pytest.mark.slow
def test_a_real_prometheus_scrapes_it_and_answers_rules_and_dashboard(tmp_path):
    program = shutil.which("prometheus")
    if program is None:
        pytest.skip("not installed: prometheus (Debian's package)")
    bench, port = Bench(tmp_path), free_port()
    driven = bench.service()
    bench.drive(driven)
    driven.engine.router.rejected["checksum"] += 2
    with running(driven) as service:
        metrics = [
            sys.executable,
            "-m",
            "imucald",
            "metrics",
            "--listen",
            f"127.0.0.1:{free_port()}",
        ]
        metrics += ["--socket", str(service.options.status_socket)]
        scrape = {"job_name": "car", "static_configs": [{"targets": [metrics[5]]}]}
        config = {"global": {"scrape_interval": "1s", "evaluation_interval": "1s"}}
        config |= {
            "rule_files": [str(MONITORING / "imucald-alerts.yml")],
            "scrape_configs": [scrape],
        }
        (tmp_path / "prometheus.yml").write_text(json.dumps(config))
        command = [program, f"--config.file={tmp_path}/prometheus.yml"]
        command += [f"--storage.tsdb.path={tmp_path}/db", f"--web.listen-address=127.0.0.1:{port}"]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        processes = [subprocess.Popen(metrics, **quiet), subprocess.Popen(command, **quiet)]
        try:
            wait_until(lambda: asked(port, "query?query=imucald_up")["result"], 30.0)
            (found,) = asked(port, "query?query=imucald_up")["result"]
            assert found["value"][1] == "1"
            wait_until(lambda: {"ok"} == rule_health(port), 30.0)
            wait_until(lambda: not without_data(port), 30.0)
        finally:
            for process in processes:
                process.terminate()
                process.wait(10.0)


def asked(port: int, what: str) -> dict[str, list[dict[str, object]]]:
    """What Prometheus answers; an empty result while it starts."""
    try:
        with urllib.request.urlopen(
            f"http://127.0.0.1:{port}/api/v1/{what}", timeout=5.0
        ) as answer:
            return dict(json.loads(answer.read())["data"])
    except OSError:
        return {"result": [], "groups": []}


def without_data(port: int) -> list[str]:
    """Queries of the dashboard that come to nothing, but for those that only find faults."""
    return [
        expr
        for expr in expressions()
        if not expr.endswith("> 0") and "send_errors" not in expr and not series(port, expr)
    ]


def series(port: int, expr: str) -> list[dict[str, object]]:
    """What a panel shows, of all machines and buses."""
    for name, value in (("$__rate_interval", "8s"), ("$instance", ".+"), ("$bus", ".+")):
        expr = expr.replace(name, value)
    return asked(port, f"query?{urllib.parse.urlencode({'query': expr})}")["result"]


def rule_health(port: int) -> set[object]:
    return {rule["health"] for group in asked(port, "rules")["groups"] for rule in group["rules"]}


def is_open(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def wait_until(condition, limit: float) -> None:
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.slow
def test_the_alert_rules_pass_their_own_tests(promtool):
    checked(promtool, "check", "rules", str(MONITORING / "imucald-alerts.yml"))
    checked(promtool, "test", "rules", str(MONITORING / "imucald-alerts.test.yml"))


def expressions() -> list[str]:
    board = json.loads((MONITORING / "imucald-grafana.json").read_text())
    found = [t["expr"] for panel in board["panels"] for t in panel["targets"]]
    # Grafana reads an annotation's query from its target (standardAnnotationSupport.ts)
    return found + [note["target"]["expr"] for note in board["annotations"]["list"]]


def test_dashboard_and_rules_name_metrics_that_there_are(metrics_and_status):
    text = (
        gathered([])
        + metrics_and_status[0]
        + "imucald_link_send_errors_total node_textfile_mtime_seconds"
    )
    named = set(re.findall(r"\b(?:imucald|node)_\w+", " ".join(expressions())))
    rules = (MONITORING / "imucald-alerts.yml").read_text()
    exprs = " ".join(re.findall(r"expr: (?:>-\n)?(.+?)\n        ?(?:for|labels)", rules, re.S))
    named |= set(re.findall(r"\b(?:imucald|node)_\w+", exprs))
    assert len(named) > 15
    assert {name for name in named if name not in text} == set()


def test_the_first_panel_shows_only_good_frames_that_flow(promtool, tmp_path):
    """A daemon without input, and one that does not answer, keep their quality and their mount."""
    expr = expressions()[0].replace("$instance", ".*").replace("$bus", ".*")
    shown = {
        "driving": ({"up": 1, "quality": 2, "corrected_frames_flow": 1}, 2),
        "silent": ({"up": 1, "quality": 3, "corrected_frames_flow": 0}, 0),
        "suspect": ({"up": 1, "quality": 4, "corrected_frames_flow": 0}, 0),
        "dead": ({"up": 0}, -1),
    }
    labels = 'instance="a", bus="{}"'
    series = [
        {"series": f"imucald_{name}{{{labels.format(bus)}}}", "values": f"{value}x5"}
        for bus, (values, _) in shown.items()
        for name, value in values.items()
    ]
    samples = [
        {"labels": f"{{{labels.format(bus)}}}", "value": value} for bus, (_, value) in shown.items()
    ]
    wanted = {"expr": expr, "eval_time": "3m", "exp_samples": samples}
    tests = [{"interval": "1m", "input_series": series, "promql_expr_test": [wanted]}]
    file = tmp_path / "panel.yml"
    file.write_text(json.dumps({"tests": tests}))
    checked(promtool, "test", "rules", str(file))
    board = json.loads((MONITORING / "imucald-grafana.json").read_text())
    (value,) = board["panels"][0]["fieldConfig"]["defaults"]["mappings"]
    green = {int(n) for n, look in value["options"].items() if look["color"] == "green"}
    assert green == {2, 3}
    assert board["panels"][0]["targets"][0]["instant"], "an older value is none of now"


def test_every_expression_of_the_dashboard_is_promql(promtool, tmp_path):
    rules = [
        {"record": f"x:{i}", "expr": expr.replace("$__rate_interval", "5m")}
        for i, expr in enumerate(expressions())
    ]
    file = tmp_path / "rules.yml"
    file.write_text(json.dumps({"groups": [{"name": "board", "rules": rules}]}))
    checked(promtool, "check", "rules", str(file))
    file.write_text(
        json.dumps({"groups": [{"name": "b", "rules": [{"record": "x", "expr": "1 +"}]}]})
    )
    with pytest.raises(AssertionError):
        checked(promtool, "check", "rules", str(file))
