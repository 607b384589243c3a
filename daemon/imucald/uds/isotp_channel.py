"""ISO-TP (ISO 15765-2) in the daemon's loop. Frames are processed without a thread and with limits.

The package `can-isotp` handles the segments. Every received frame may be hostile. Therefore the
number of processed frames, the length of requests and responses, and their duration are limited.
Refused frames and requests are counted.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, Final

from imucald.can.columns import CAN_EFF_FLAG, CAN_SFF_MASK
from imucald.core.libraries import standing_in

MAX_REQUEST: Final = 128
"""Longest request [bytes]: twice the length of the longest valid request. For a longer request, the
flow control frame states "overflow"."""
FRAMES_PER_SECOND: Final = 500.0
"""Largest average rate of processed frames [1/s]. The limit is much more than a tester sends."""
FRAMES_AT_ONCE: Final = 200.0
"""Largest burst of processed frames."""
SEND_WINDOW_S: Final = 0.05
FRAMES_PER_WINDOW: Final = 16
"""Number of frames sent per window. Together with the corrected frames, this number fits the send
queue of the interface."""
PADDING: Final = 0xCC
"""Byte that fills frames up to 8 bytes (ISO 15765-2)."""
LONGEST_RESPONSE_S: Final = 10.0
"""Longest time for sending a response [s]. If the receiver delays the response for longer, the
response is aborted."""
BUSY_WAIT_S: Final = 0.005
"""Time until the next call of `poll` while a response is being sent [s]."""

CanFrame = tuple[int, bytes]
"""Id (with the flag for 29 bits) and payload of a frame to send."""

Handler = Callable[[bytes, bool], bytes | None]
"""Function that answers a request. Arguments: the request, and whether it was sent to all nodes.
The function returns a response or None."""


def import_isotp() -> Any:
    """Import can-isotp without python-can. can-isotp needs python-can only for its own buses.

    The partial import saves 10 MiB (a daemon may use 50 MiB) and 45 ms. Raises ImportError if
    can-isotp is not installed.
    """
    with standing_in("can", None):
        import isotp  # noqa: PLC0415

    return isotp


def flagged(can_id: int) -> int:
    """Return an id in the form of links: with the flag if it has 29 bits."""
    return can_id | (CAN_EFF_FLAG if can_id > CAN_SFF_MASK else 0)


class IsoTpChannel:
    """The channel for the requests of one tester. Requests are processed one after the other.

    handle: function that answers a request. clock: monotonic [s]. Ids are stated as in the
    configuration, without the flag for 29 bits.
    Raises ImportError if can-isotp is not installed.
    """

    def __init__(
        self,
        request_id: int,
        response_id: int,
        functional_id: int | None,
        handle: Handler,
        clock: Callable[[], float],
    ) -> None:
        self.counters: Counter[str] = Counter()
        """Numbers of frames, requests, dropped items, and errors of the transport, by name."""
        self.request_id = flagged(request_id)
        self.response_id = flagged(response_id)
        self.functional_id = None if functional_id is None else flagged(functional_id)
        self._handle = handle
        self._clock = clock
        self._allowance = FRAMES_AT_ONCE
        self._counted_at = clock()
        self._sending_since: float | None = None
        self._in: deque[Any] = deque(maxlen=1)
        self._out: list[CanFrame] = []
        isotp = import_isotp()
        self._message = isotp.CanMessage
        self._extended = response_id > CAN_SFF_MASK
        self._raw_request_id = request_id
        mode = isotp.AddressingMode
        self._stack = isotp.TransportLayerLogic(
            rxfn=lambda _timeout: self._in.popleft() if self._in else None,
            txfn=self._sent,
            address=isotp.Address(
                mode.Normal_29bits if self._extended else mode.Normal_11bits,
                txid=response_id,
                rxid=request_id,
            ),
            error_handler=self._failed,
            params={
                "max_frame_size": MAX_REQUEST,
                "tx_padding": PADDING,
                "rate_limit_enable": True,
                "rate_limit_max_bitrate": round(64 * FRAMES_PER_WINDOW / SEND_WINDOW_S),
                "rate_limit_window_size": SEND_WINDOW_S,
                "logger_name": _silent_logger(),
            },
        )

    @property
    def ids(self) -> frozenset[int]:
        """The ids of received frames, with the flag for 29 bits."""
        return frozenset(i for i in (self.request_id, self.functional_id) if i is not None)

    @property
    def wait(self) -> float:
        """Longest time until the next call of `poll` [s]."""
        return float("inf") if self._sending_since is None else BUSY_WAIT_S

    def frame(self, can_id: int, data: bytes) -> list[CanFrame]:
        """Process a frame with one of `ids`. Return the frames to send."""
        if not self._is_allowed():
            self.counters["dropped"] += 1
            return []
        self.counters["frames"] += 1
        if can_id == self.functional_id:
            self._take_functional(data)
        else:
            self._in.append(
                self._message(self._raw_request_id, len(data), data, extended_id=self._extended)
            )
            self._process()
            while (request := self._stack.recv()) is not None:
                self._answer(bytes(request), to_all=False)
        return self._taken()

    def poll(self) -> list[CanFrame]:
        """Continue a response. Return the frames to send."""
        since = self._sending_since
        if since is not None and self._clock() - since > LONGEST_RESPONSE_S:
            self._give_up()
        if since is not None or self._stack.is_rx_active():
            self._process()
        return self._taken()

    def _is_allowed(self) -> bool:
        """True if one more frame may be processed now."""
        now = self._clock()
        earned = (now - self._counted_at) * FRAMES_PER_SECOND
        self._allowance = min(self._allowance + earned, FRAMES_AT_ONCE)
        self._counted_at = now
        if self._allowance < 1.0:
            return False
        self._allowance -= 1.0
        return True

    def _take_functional(self, data: bytes) -> None:
        """Process a request to all nodes. Such a request must be a single frame; longer requests
        are not answered."""
        length = data[0] if data else 0
        if not 1 <= length <= 7 or len(data) <= length:
            self.counters["not_a_functional_request"] += 1
            return
        self._answer(data[1 : 1 + length], to_all=True)

    def _answer(self, request: bytes, to_all: bool) -> None:
        self.counters["requests"] += 1
        response = self._handle(request, to_all)
        if response is None:
            return
        if self._stack.transmitting():
            if to_all:  # a running response to one tester has priority
                self.counters["functional_response_dropped"] += 1
                return
            self._give_up()  # a new request: the tester does not wait for the rest
        self._stack.send(response)
        self._sending_since = self._clock()
        self._process(receive=False)

    def _give_up(self) -> None:
        self.counters["response_given_up"] += 1
        self._stack.stop_sending()
        self._stack.clear_tx_queue()
        self._sending_since = None

    def _process(self, receive: bool = True) -> None:
        try:
            self._stack.process(0.0, do_rx=receive)
        except Exception:  # others' code at work on hostile input: it must not end the daemon
            self.counters["transport_failed"] += 1
            self._stack.reset()
        if not self._stack.transmitting():
            self._sending_since = None

    def _sent(self, message: Any) -> None:
        self._out.append((self.response_id, bytes(message.data)))

    def _taken(self) -> list[CanFrame]:
        out, self._out = self._out, []
        return out

    def _failed(self, error: Exception) -> None:
        self.counters[type(error).__name__] += 1


def _silent_logger() -> str:
    """Return the name of a silent logger. Damaged frames are counted instead of being logged."""
    logger = logging.getLogger("imucald.isotp")
    logger.disabled = True
    return logger.name
