"""The bus link on a python-can adapter that fails: pulled out, refusing, plugged in again."""

from __future__ import annotations

import time
from typing import Any

import pytest

from imucald.can.columns import CAN_EFF_FLAG, CAN_SFF_MASK, IdMatch
from imucald.can.link.link import Link, LinkState
from imucald.can.python_can import can
from imucald.core.errors import LinkError

MATCHES = [IdMatch(0x123, CAN_SFF_MASK), IdMatch(0x18FEF100 | CAN_EFF_FLAG, 0x00FFFF00)]


class Plug:
    """A USB adapter as python-can shows it; `can.Bus` opens it while it is plugged in."""

    def __init__(self) -> None:
        self.there = True
        self.queue: list[Any] = []
        self.opened_with: list[dict[str, Any]] = []
        self.send_fails: Exception | None = None

    def open(self, **arguments: Any) -> Plug:
        self.opened_with.append(arguments)
        if not self.there:
            raise can.CanInitializationError("no device")
        return self

    def recv(self, timeout: float) -> Any:
        if not self.there:
            raise can.CanOperationError("device gone")
        if not self.queue:
            time.sleep(timeout)
            return None
        return self.queue.pop(0)

    def send(self, message: Any, timeout: float) -> None:
        if self.send_fails is not None:
            raise self.send_fails

    def fileno(self) -> int:
        raise NotImplementedError

    def shutdown(self) -> None:
        raise can.CanOperationError("device gone")


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    adapter = Plug()
    monkeypatch.setattr(can, "Bus", adapter.open)
    return adapter


def test_the_driver_gets_filters_bit_rate_and_options(plug: Plug) -> None:
    options = {"serial": "X1"}
    with Link("kvaser", "0", receive=MATCHES, own_ids=[0x600], bitrate=500_000, options=options):
        pass
    (arguments,) = plug.opened_with
    assert arguments.pop("can_filters") == [
        {"can_id": 0x123, "can_mask": 0x7FF, "extended": False},
        {"can_id": 0x18FEF100, "can_mask": 0x00FFFF00, "extended": True},
        {"can_id": 0x600, "can_mask": 0x7FF, "extended": False},
    ]
    assert arguments == {"interface": "kvaser", "channel": "0", "bitrate": 500_000, "serial": "X1"}


def test_pulled_out_and_plugged_in_again(plug: Plug) -> None:
    kinds: list[str] = []
    link = Link("kvaser", "0", receive=MATCHES, on_event=lambda event: kinds.append(event.kind))
    plug.there = False
    assert link.receive(0.1) == []
    assert link.state is LinkState.ABSENT
    assert not link.send(0x600, b"")
    plug.there = True
    plug.queue = [can.Message(arbitration_id=0x123, data=b"\x01", is_extended_id=False)]
    start = time.monotonic()
    assert [data for _, _, data in link.receive(2.0)] == [b"\x01"]
    assert time.monotonic() - start < 1.0
    assert kinds == ["up", "absent", "up"]
    assert link.counters.reopened == 1


def test_frames_taken_before_the_failure_are_kept(plug: Plug) -> None:
    class Pulled(list[Any]):
        def pop(self, index: Any = -1) -> Any:
            plug.there = len(self) > 1
            return super().pop(index)

    link = Link("kvaser", "0", receive=MATCHES)
    plug.queue = Pulled(
        [can.Message(arbitration_id=0x123, data=bytes([i]), is_extended_id=False) for i in (1, 2)]
    )
    assert [data for _, _, data in link.receive(0.1)] == [b"\x01", b"\x02"]
    assert link.receive(0.1) == []
    assert link.state is LinkState.ABSENT


def test_echoes_of_our_own_frames_are_neither_input_nor_conflict(plug: Plug) -> None:
    link = Link("kvaser", "0", receive=MATCHES, own_ids=[0x600])
    plug.queue = [
        can.Message(arbitration_id=can_id, is_extended_id=False, is_rx=False)
        for can_id in (0x123, 0x600)
    ]
    assert link.receive(0.05) == []
    assert link.counters.conflicts == 0


def test_error_frames_of_an_adapter_tell_of_bus_off(plug: Plug) -> None:
    link = Link("kvaser", "0", receive=MATCHES)
    plug.queue = [can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False)]
    link.receive(0.05)
    assert link.state is LinkState.BUS_OFF


@pytest.mark.parametrize(
    "error", [can.CanOperationError("queue full"), OSError("write failed"), ValueError("length")]
)
def test_a_refused_frame_is_counted_and_the_adapter_kept(plug: Plug, error: Exception) -> None:
    link = Link("kvaser", "0", receive=MATCHES)
    plug.send_fails = error
    assert not link.send(0x600, b"\x01")
    assert link.counters.send_errors == {"adapter": 1}
    assert link.state is LinkState.UP


def test_not_plugged_in_at_the_start(plug: Plug) -> None:
    plug.there = False
    with pytest.raises(LinkError, match="no device: is it plugged in"):
        Link("kvaser", "0", receive=MATCHES)
    link = Link("kvaser", "0", receive=MATCHES, wait=True)
    assert link.state is LinkState.ABSENT
