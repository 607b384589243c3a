"""Diagnostics on the bus: the server of `imucald.uds` in the running daemon.

Diagnostics are switched off by default. The main loop (`live.Daemon`) passes the frames with the
request ids to the server and sends the answers.
"""

from __future__ import annotations

import importlib
import importlib.util
import time
from collections.abc import Callable
from typing import Any, Final

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK, IdMatch
from imucald.config import LoadedConfig
from imucald.config.network import Uds
from imucald.core.errors import ConfigError
from imucald.core.libraries import how_to_install
from imucald.runtime.engine import Engine
from imucald.runtime.output.output_message import OutFrame
from imucald.runtime.session import make_engine
from imucald.service.uds_host import LiveHost, RunningService
from imucald.service.uds_records import AttemptStore
from imucald.uds.dtc import DtcMemory, DtcStatus
from imucald.uds.identifiers import Identifier, u32
from imucald.uds.isotp_channel import IsoTpChannel, flagged
from imucald.uds.security import KeyFunction, Security
from imucald.uds.server import Server

JUDGE_S: Final = 0.2
"""Period of the tests of the DTCs [s]."""
TRANSPORT_COUNTERS_IDENTIFIER: Final = 0xFD0C
TRANSPORT_COUNTERS: Final = (
    "frames",
    "dropped",
    "requests",
    "response_given_up",
    "functional_response_dropped",
)


class BusUds:
    """Diagnostic server, transport protocol and DTCs of one daemon. No method waits."""

    def __init__(
        self,
        service: RunningService,
        config: Uds,
        key_function: KeyFunction | None = None,
        clock: Callable[[], float] = time.monotonic,
        dtcs: DtcMemory | None = None,
        keys: AttemptStore | None = None,
    ) -> None:
        keys = keys or AttemptStore(None, lambda *_: None)
        self.host = LiveHost(service, clock)
        self.server = Server(
            self.host,
            clock,
            Security(
                key_function,
                clock,
                attempts=config.security.attempts,
                delay=config.security.delay,
                wrong=keys.wrong,
                on_count=keys.put_count,
            ),
            more={
                TRANSPORT_COUNTERS_IDENTIFIER: Identifier(
                    "transport counters", lambda _: self._transport_counted()
                )
            },
            dtcs=dtcs,
        )
        self.channel = IsoTpChannel(
            config.request_id,
            config.response_id,
            config.functional_id,
            self.server.handle,
            clock,
        )
        self._service = service
        self._clock = clock
        self._next_judgement = clock()
        self._keys_refused = 0

    @property
    def ids(self) -> frozenset[int]:
        """Ids of received frames, with the flag for 29 bits. The engine does not get these
        frames."""
        return self.channel.ids

    @property
    def matches(self) -> list[IdMatch]:
        """The filters of the tester's frames for the bus link."""
        return [
            IdMatch(i, CAN_EFF_MASK if i & CAN_EFF_FLAG else CAN_SFF_MASK) for i in sorted(self.ids)
        ]

    @property
    def own_ids(self) -> frozenset[int]:
        """The ids that no other node may send."""
        return frozenset({self.channel.response_id})

    @property
    def wait(self) -> float:
        """The longest time until the next call of `poll` [s]."""
        return min(self.channel.wait, JUDGE_S)

    def frame(self, can_id: int, data: bytes) -> list[OutFrame]:
        """Handle a frame with one of `ids`. Return the frames to send."""
        return self.channel.frame(can_id, data)

    def poll(self) -> list[OutFrame]:
        """Handle time-outs and test the DTCs. Return the frames to send."""
        now = self._clock()
        if now >= self._next_judgement:
            self._next_judgement = now + JUDGE_S
            self.server.poll()
            self.server.dtcs.update(now, self.host.symptoms())
            self._tell_refused_keys()
        return self.channel.poll()

    def status(self) -> dict[str, Any]:
        """Return the part of `imucald status` about diagnostics."""
        server, counters = self.server, self.server.counters
        return {
            "session": server.session.name.lower(),
            "unlocked": server.security.unlocked,
            "requests": counters.requests,
            "refused": counters.refused,
            "keys_refused": server.security.refused,
            "transport": dict(sorted(self.channel.counters.items())),
            "trouble_codes": {
                dtc.display: f"{record.status:02X}"
                for dtc, record in server.dtcs
                if record.status & (DtcStatus.TEST_FAILED | DtcStatus.PENDING | DtcStatus.CONFIRMED)
            },
        }

    def _tell_refused_keys(self) -> None:
        if self.server.security.refused != self._keys_refused:
            self._keys_refused = self.server.security.refused
            self._service.log_tester(f"so far {self._keys_refused} keys of testers were refused")

    @staticmethod
    def check_identifiers(loaded: LoadedConfig, engine: Engine) -> None:
        """Raise ConfigError if a diagnostic id is also the id of an input or output of the
        engine."""
        config = loaded.config.diagnostics
        for key in ("request_id", "response_id", "functional_id"):
            can_id = getattr(config, key)
            if can_id is None:
                continue
            wire_id, taken = flagged(can_id), ""
            if wire_id in engine.output.can_ids:
                taken = "an output id"
            elif any(not (wire_id ^ m.can_id) & m.full_mask for m in engine.router.matches):
                taken = "an input id"
            if taken:
                text = f"0x{can_id:X} is also {taken}; choose another id"
                raise loaded.error(("diagnostics", key), text)

    def _transport_counted(self) -> bytes:
        counters = self.channel.counters
        known = [counters[name] for name in TRANSPORT_COUNTERS]
        errors = counters.total() - sum(known)
        return u32(*known, errors)


def bus_uds_for(
    service: RunningService,
    loaded: LoadedConfig,
    engine: Engine,
    clock: Callable[[], float] = time.monotonic,
    dtcs: DtcMemory | None = None,
    keys: AttemptStore | None = None,
) -> BusUds:
    """Return the diagnostics of a configuration.

    service: used only after the start. dtcs, keys: the existing memory of DTCs and the existing
    count of wrong keys, if any. Raises ConfigError with the place of a mistake.
    """
    key_function = _checked_key_function(loaded, engine)
    try:
        return BusUds(service, loaded.config.diagnostics, key_function, clock, dtcs, keys)
    except ImportError:
        raise _lacks_isotp(loaded) from None


def check_start(loaded: LoadedConfig) -> None:
    """Raise ConfigError if `imucald run` would end with this error for the configuration. No bus
    is opened."""
    engine = make_engine(loaded)
    if loaded.config.diagnostics.enabled:
        _checked_key_function(loaded, engine)
        if importlib.util.find_spec("isotp") is None:
            raise _lacks_isotp(loaded)


def _checked_key_function(loaded: LoadedConfig, engine: Engine) -> KeyFunction | None:
    """Return the function that checks a tester's key; None if there is none. Raises ConfigError if
    an identifier of the diagnostics is already used."""
    BusUds.check_identifiers(loaded, engine)
    name = loaded.config.diagnostics.security.key_function
    return None if name is None else _load_key_function(loaded, name)


def _lacks_isotp(loaded: LoadedConfig) -> ConfigError:
    text = f"needs the package can-isotp: {how_to_install('diagnostics')}"
    return loaded.error(("diagnostics", "enabled"), text)


def _load_key_function(loaded: LoadedConfig, name: str) -> KeyFunction:
    place = ("diagnostics", "security", "key_function")
    module_name, _, function_name = name.partition(":")
    try:
        function = getattr(importlib.import_module(module_name), function_name)
    except Exception as error:  # whatever that module does when it is imported
        raise loaded.error(place, f"{name} cannot be imported: {error}") from None
    if not callable(function):
        raise loaded.error(place, f"{name} is not a function")
    found: KeyFunction = function
    return found
