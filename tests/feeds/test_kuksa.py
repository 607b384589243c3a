"""The KUKSA feed against a server of the databroker's own protocol.

The databroker itself is a binary that no package registry here has. What stands in for it is
generated from the same protobufs (they come with kuksa-client), knows the signals of VSS 6.0 and
of config/imucald-vss.json, and does as the databroker's source says: a published datapoint without
a value makes the signal *not available*, one of another type or outside its limits is refused, and
a signal that is not known is NOT_FOUND.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from concurrent import futures
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import grpc
import pytest
from kuksa.val.v1 import types_pb2 as types_v1
from kuksa.val.v1 import val_pb2 as val_v1
from kuksa.val.v1 import val_pb2_grpc as grpc_v1
from kuksa.val.v2 import val_pb2 as val_v2
from kuksa.val.v2 import val_pb2_grpc as grpc_v2

from feed_bench import AHEAD, calibrated, fed, source_of, traffic, wait_until
from imucald.feeds.daemon_source import Reading
from imucald.feeds.feed_loop import Feed, ReceiverError
from imucald.feeds.kuksa import PATHS, KuksaReceiver, KuksaSettings, vss_values

OVERLAY = Path(__file__).resolve().parents[2] / "config" / "imucald-vss.json"
STANDARD = {  # of VSS 6.0
    **{f"Vehicle.Acceleration.{n}": "float" for n in ("Longitudinal", "Lateral", "Vertical")},
    **{f"Vehicle.AngularVelocity.{n}": "float" for n in ("Roll", "Pitch", "Yaw")},
}
TYPES = {"float": types_v1.DATA_TYPE_FLOAT, "string": types_v1.DATA_TYPE_STRING,
         "uint8": types_v1.DATA_TYPE_UINT8, "boolean": types_v1.DATA_TYPE_BOOLEAN}  # fmt: skip
FIELDS = {"float": "float", "string": "string", "uint8": "uint32", "boolean": "bool"}


def leaves(node: dict[str, Any], path: str) -> Iterator[tuple[str, dict[str, Any]]]:
    for name, child in node.get("children", {}).items():
        yield from (
            leaves(child, f"{path}.{name}") if "children" in child else [(f"{path}.{name}", child)]
        )


OWN = dict(leaves(json.loads(OVERLAY.read_text())["Vehicle"], "Vehicle"))


class Databroker(grpc_v1.VALServicer, grpc_v2.VALServicer):
    """Signals by path with their types; `values` has what was published (None: not available)."""

    def __init__(self, types: dict[str, str], port: int = 0) -> None:
        self.types = types
        self.values: dict[str, Any] = {}
        self._server = grpc.server(futures.ThreadPoolExecutor(4))
        v1, v2 = _v1(self), _v2(self)
        grpc_v1.add_VALServicer_to_server(v1, self._server)
        grpc_v2.add_VALServicer_to_server(v2, self._server)
        self.port = self._server.add_insecure_port(f"127.0.0.1:{port}")
        self._server.start()

    def stop(self) -> None:
        self._server.stop(None).wait()

    def present(self, path: str) -> Any:
        """The value of a signal as soon as it has one, read once: it may be gone any time."""
        found: list[Any] = []

        def is_there() -> bool:
            found.append(self.values.get(path))
            return found[-1] is not None

        wait_until(is_there)
        return found[-1]

    def metadata(self, request: Any) -> Any:
        answer = val_v1.GetResponse()
        for entry in request.entries:
            if entry.path not in self.types:
                answer.error.code, answer.error.reason = 404, "not_found"
                more = answer.errors.add(path=entry.path)
                more.error.code = 404
                continue
            found = answer.entries.add(path=entry.path)
            found.metadata.data_type = TYPES[self.types[entry.path]]
        return answer

    def publish(self, request: Any, context: Any) -> Any:
        path = request.signal_id.path
        if path not in self.types:
            context.abort(grpc.StatusCode.NOT_FOUND, "Path not found")
        if not request.data_point.HasField("value"):
            self.values[path] = None
            return val_v2.PublishValueResponse()
        value = request.data_point.value
        field = value.WhichOneof("typed_value")
        if field != FIELDS[self.types[path]]:
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"{path}: wrong type {field}")
        found = getattr(value, field)
        allowed = OWN.get(path, {}).get("allowed")
        if allowed is not None and found not in allowed:
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, f"{path}: {found} is not allowed")
        self.values[path] = found
        return val_v2.PublishValueResponse()


def _v1(broker: Databroker) -> Any:
    class V1(grpc_v1.VALServicer):
        def Get(self, request, context):
            return broker.metadata(request)

    return V1()


def _v2(broker: Databroker) -> Any:
    class V2(grpc_v2.VALServicer):
        def PublishValue(self, request, context):
            return broker.publish(request, context)

    return V2()


@contextmanager
def databroker(own: bool = True, port: int = 0) -> Iterator[Databroker]:
    types = {**STANDARD, **({path: one["datatype"] for path, one in OWN.items()} if own else {})}
    made = Databroker(types, port)
    try:
        yield made
    finally:
        made.stop()


def receiver_of(port: int, messages: list[str]) -> KuksaReceiver:
    return KuksaReceiver(KuksaSettings("127.0.0.1", port), messages.append)


def test_every_path_is_one_of_vss_or_of_our_own_branch():
    assert set(PATHS) == set(STANDARD) | set(OWN)


def test_corrected_values_and_the_mount_become_vss_signals(tmp_path):
    messages: list[str] = []
    with (
        calibrated(tmp_path) as (_, service),
        traffic(service.link.channel) as silent,
        databroker() as broker,
    ):
        feed = Feed(
            source_of(service, messages), receiver_of(broker.port, messages), 0.1, messages.append
        )
        ahead, above = "Vehicle.Acceleration.Longitudinal", "Vehicle.Acceleration.Vertical"
        with fed(feed):
            # the signals of a reading come one by one: each is waited for before it is looked at
            assert broker.present(ahead) == pytest.approx(AHEAD, abs=0.15)
            assert broker.present(above) == pytest.approx(9.8, abs=0.15)
            turning, own = "Vehicle.AngularVelocity.Yaw", "Vehicle.Private.Imucald"
            wait_until(lambda: turning in broker.values)
            assert broker.values[turning] is None, "there is no gyroscope on the bus"
            wait_until(lambda: f"{own}.Mount.DeviationZ" in broker.values)
            truth = service.status()
            assert broker.present(f"{own}.State") == truth["state"]
            assert broker.present(f"{own}.IsHeld") is True
            yaw = broker.present(f"{own}.Mount.Yaw")
            assert yaw == pytest.approx(truth["mount"]["yaw_deg"], abs=0.01)
            silent.set()
            wait_until(lambda: broker.values[ahead] is None)
            silent.clear()
            wait_until(lambda: broker.values[ahead] is not None)
        assert set(broker.values) == set(PATHS)
        assert set(broker.values.values()) == {None}, "a feed that ends leaves no old value"


def test_signals_that_a_databroker_does_not_know_are_reported_once_and_left_out(tmp_path):
    messages: list[str] = []
    with calibrated(tmp_path) as (_, service), databroker(own=False) as broker:
        receiver = receiver_of(broker.port, messages)
        for _ in range(2):
            receiver.connect()
            receiver.publish(Reading(0.0, service.status(), corrected={"acceleration": None}))
            receiver.disconnect()
        assert set(broker.values) == {p for p in STANDARD if "Acceleration" in p}
    missed = [text for text in messages if "does not know" in text]
    assert len(missed) == len(OWN)
    assert "config/imucald-vss.json" in missed[0]
    with databroker() as empty:
        empty.types.clear()
        receiver = receiver_of(empty.port, messages)
        with pytest.raises(ReceiverError, match="does not know any of"):
            receiver.connect()
        receiver.disconnect()


@pytest.mark.slow
def test_a_databroker_that_comes_late_or_goes_is_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr("imucald.feeds.feed_loop.LONGEST_PAUSE_S", 1.0)
    messages: list[str] = []
    with databroker() as broker:
        port = broker.port
    with calibrated(tmp_path) as (_, service), traffic(service.link.channel):
        feed = Feed(source_of(service, messages), receiver_of(port, messages), 0.1, messages.append)
        with fed(feed):
            wait_until(lambda: any("trying again" in text for text in messages))
            for _ in range(2):
                with databroker(port=port) as broker:
                    path = "Vehicle.Acceleration.Longitudinal"
                    wait_until(lambda broker=broker, path=path: broker.values.get(path), 30.0)
    assert all("Traceback" not in text for text in messages)
    assert any("takes 15 signals" in text for text in messages)


def test_without_a_daemon_nothing_is_available():
    values = vss_values(Reading(0.0, None, corrected={"acceleration": None}))
    assert set(values.values()) == {None}
    assert len(values) == len(PATHS) - 3


def test_a_value_that_is_refused_is_an_error_of_the_receiver_not_of_the_feed(tmp_path):
    messages: list[str] = []
    with calibrated(tmp_path) as (_, service), databroker() as broker:
        receiver = receiver_of(broker.port, messages)
        receiver.connect()
        wrong = {**service.status(), "state": "nonsense"}
        with pytest.raises(ReceiverError, match="nonsense is not allowed"):
            receiver.publish(Reading(0.0, wrong))
        receiver.disconnect()
    assert threading.active_count() < 50


@pytest.mark.parametrize("kind", ["string", "uint8"])
def test_a_databroker_with_other_types_is_an_error_of_the_receiver(kind):
    reading = Reading(0.0, None, False, {"acceleration": (-1.0, 0.5, 9.8)})
    with databroker() as broker:
        broker.types["Vehicle.Acceleration.Longitudinal"] = kind
        receiver = receiver_of(broker.port, [])
        receiver.connect()
        with pytest.raises(ReceiverError, match="its answer cannot be understood"):
            receiver.publish(reading)
        receiver.disconnect()


def test_a_databroker_that_answers_for_other_signals_is_an_error_of_the_receiver(monkeypatch):
    empty = val_v1.GetResponse()
    with databroker() as broker:
        monkeypatch.setattr(broker, "metadata", lambda _request: empty)
        receiver = receiver_of(broker.port, [])
        with pytest.raises(ReceiverError, match="its answer cannot be understood"):
            receiver.connect()
        receiver.disconnect()
