"""The UDS server: sessions, the services that are allowed in them, and negative responses.

A request is checked in the order of ISO 14229-1: service, session, length, sub-function, and then
the conditions of the service.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final

from imucald.uds.codes import (
    NEGATIVE,
    POSITIVE,
    SUPPRESS,
    Answer,
    Nrc,
    Session,
    Sid,
)
from imucald.uds.dtc import DtcMemory
from imucald.uds.dtc_services import (
    BY_MASK,
    COUNT_BY_MASK,
    EXTENDED_DATA,
    SUPPORTED,
    clear_dtcs,
    read_dtcs,
)
from imucald.uds.host import Host
from imucald.uds.identifiers import Identifier, ReadData, u32
from imucald.uds.routines import RESULTS, START, STOP, Routines
from imucald.uds.security import REQUEST_SEED, SEND_KEY, Security

S3_S: Final = 5.0
"""A session ends after this time without a request [s]."""

NOT_ANSWERED_TO_ALL: Final = frozenset(
    {
        Nrc.SERVICE_NOT_SUPPORTED,
        Nrc.SUB_FUNCTION_NOT_SUPPORTED,
        Nrc.OUT_OF_RANGE,
        Nrc.SUB_FUNCTION_NOT_IN_SESSION,
        Nrc.SERVICE_NOT_IN_SESSION,
    }
)
"""Negative response codes that are not sent as an answer to a request to all nodes, because such a
request is probably for other nodes."""


@dataclass(frozen=True)
class UdsService:
    """One service. answer: function that answers a request. Its argument is the request without the
    service id.

    shortest: length of the shortest request [bytes]. sub_functions: None if there are none.
    """

    answer: Callable[[bytes], Answer]
    sessions: frozenset[Session] = frozenset(Session)
    shortest: int = 2
    sub_functions: frozenset[int] | None = None


@dataclass
class ServerCounters:
    """Numbers of requests since the start. Unanswered requests are counted in `refused` too."""

    requests: int = 0
    refused: int = 0
    ended_sessions: int = 0
    """Number of sessions that ended because there was no request."""


class Server:
    """Answers requests about one host.

    clock: monotonic [s]. security: the lock of the routines. more: identifiers in addition to the
    identifiers of the host. dtcs: an existing DTC memory.
    """

    def __init__(
        self,
        host: Host,
        clock: Callable[[], float],
        security: Security,
        more: Mapping[int, Identifier] | None = None,
        dtcs: DtcMemory | None = None,
    ) -> None:
        self.session = Session.DEFAULT
        self.dtcs = DtcMemory() if dtcs is None else dtcs
        self.counters = ServerCounters()
        self.security = security
        self._clock = clock
        self._last_request = clock()
        self._routines = Routines(host, lambda: self.security.unlocked)
        own = {
            0xF186: Identifier("active session", lambda _: bytes([self.session])),
            0xFD0B: Identifier("diagnostics counters", lambda _: self._counted()),
            **(more or {}),
        }
        self._services: Mapping[int, UdsService] = {
            Sid.SESSION_CONTROL: UdsService(
                self._session_control, sub_functions=frozenset(map(int, Session))
            ),
            Sid.TESTER_PRESENT: UdsService(_tester_present, sub_functions=frozenset({0})),
            Sid.READ_DATA: UdsService(ReadData(host, own).answer, shortest=3),
            Sid.CLEAR_DTCS: UdsService(partial(clear_dtcs, self.dtcs), shortest=4),
            Sid.READ_DTCS: UdsService(
                partial(read_dtcs, self.dtcs),
                sub_functions=frozenset({COUNT_BY_MASK, BY_MASK, EXTENDED_DATA, SUPPORTED}),
            ),
            Sid.SECURITY_ACCESS: UdsService(
                self.security.answer,
                sessions=frozenset({Session.EXTENDED}),
                sub_functions=frozenset({REQUEST_SEED, SEND_KEY}),
            ),
            Sid.ROUTINE_CONTROL: UdsService(
                self._routines.answer,
                sessions=frozenset({Session.EXTENDED}),
                shortest=4,
                sub_functions=frozenset({START, STOP, RESULTS}),
            ),
        }

    def handle(self, request: bytes, to_all: bool = False) -> bytes | None:
        """Return the response to a request; None if there is no response. to_all: True if the
        request used functional addressing."""
        self.poll()
        if not request or request[0] & POSITIVE:  # responses of other nodes are not requests
            return None
        self._last_request = self._clock()
        self.counters.requests += 1
        answer, suppressed = self._judge(request)
        if isinstance(answer, Nrc):
            self.counters.refused += 1
            silent = to_all and answer in NOT_ANSWERED_TO_ALL
            return None if silent else bytes([NEGATIVE, request[0], answer])
        return None if suppressed else bytes([request[0] + POSITIVE]) + answer

    def poll(self) -> None:
        """End the session if there was no request for `S3_S`."""
        self._routines.poll()
        if self.session is not Session.DEFAULT and self._clock() - self._last_request > S3_S:
            self.counters.ended_sessions += 1
            self._enter(Session.DEFAULT)

    def _judge(self, request: bytes) -> tuple[Answer, bool]:
        """Return the answer to a request, and whether a positive answer is suppressed."""
        service = self._services.get(request[0])
        if service is None:
            return Nrc.SERVICE_NOT_SUPPORTED, False
        if self.session not in service.sessions:
            return Nrc.SERVICE_NOT_IN_SESSION, False
        if service.sub_functions is None:
            short = len(request) < service.shortest
            return (Nrc.INCORRECT_LENGTH if short else service.answer(request[1:])), False
        if len(request) < 2:
            return Nrc.INCORRECT_LENGTH, False
        sub, suppressed = request[1] & ~SUPPRESS, bool(request[1] & SUPPRESS)
        if sub not in service.sub_functions:
            return Nrc.SUB_FUNCTION_NOT_SUPPORTED, False
        if len(request) < service.shortest:
            return Nrc.INCORRECT_LENGTH, False
        return service.answer(bytes([sub]) + request[2:]), suppressed

    def _session_control(self, data: bytes) -> Answer:
        if len(data) != 1:
            return Nrc.INCORRECT_LENGTH
        self._enter(Session(data[0]))
        # P2: a response starts within 50 ms, one cycle of the daemon's loop. P2*: 5 s, required by
        # ISO 14229-1, although "response pending" is never sent.
        return struct.pack(">BHH", data[0], 50, 500)

    def _enter(self, session: Session) -> None:
        self.session = session
        self.security.lock()

    def _counted(self) -> bytes:
        c = self.counters
        return u32(c.requests, c.refused, self.security.refused, c.ended_sessions)


def _tester_present(data: bytes) -> Answer:
    return bytes(data) if len(data) == 1 else Nrc.INCORRECT_LENGTH
