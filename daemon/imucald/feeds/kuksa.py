"""KUKSA: send corrected values and the mount to a databroker as VSS signals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imucald.feeds.daemon_source import Reading, Say
from imucald.feeds.feed_loop import ReceiverError

CALL_S = 2.0
"""Longest time for an answer of the databroker [s]."""
OWN = "Vehicle.Private.Imucald"
"""Branch for values without a VSS signal, see config/imucald-vss.json."""
VECTORS = {
    "acceleration": [f"Vehicle.Acceleration.{n}" for n in ("Longitudinal", "Lateral", "Vertical")],
    "angular_rate": [f"Vehicle.AngularVelocity.{n}" for n in ("Roll", "Pitch", "Yaw")],
}
"""VSS signals for x, y, z of ISO 8855, in m/s^2 and degrees/s."""
_STATUS: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
    f"{OWN}.State": lambda status: status["state"],
    f"{OWN}.Quality": lambda status: status["quality"],
    f"{OWN}.IsHeld": lambda status: bool(status.get("held")),
    f"{OWN}.Mount.Roll": lambda status: status["mount"]["roll_deg"],
    f"{OWN}.Mount.Pitch": lambda status: status["mount"]["pitch_deg"],
    f"{OWN}.Mount.Yaw": lambda status: status["mount"]["yaw_deg"],
    f"{OWN}.Mount.DeviationX": lambda status: status["mount"]["std_deg"]["x"],
    f"{OWN}.Mount.DeviationY": lambda status: status["mount"]["std_deg"]["y"],
    f"{OWN}.Mount.DeviationZ": lambda status: status["mount"]["std_deg"]["z"],
}
PATHS = [*(path for paths in VECTORS.values() for path in paths), *_STATUS]


@dataclass(frozen=True)
class KuksaSettings:
    """Settings of the connection. host, port: address of the databroker. token: path of the token
    file.

    ca: path of the CA certificate for TLS. server_name: name in the certificate of the server.
    """

    host: str
    port: int
    token: Path | None = None
    ca: Path | None = None
    server_name: str | None = None


class KuksaReceiver:
    """Publishes with kuksa-client."""

    def __init__(self, settings: KuksaSettings, say: Say) -> None:
        import kuksa_client.grpc  # noqa: PLC0415 - an extra

        self._library = kuksa_client.grpc
        self._settings = settings
        self._say = say
        self._client: Any = None
        self._types: dict[str, Any] = {}
        self._reported: set[str] = set()

    @contextmanager
    def _errors_as_ours(self) -> Iterator[None]:
        """Context that converts exceptions to ReceiverError. The library does not check types and
        answers of a databroker, so wrong types or answers may cause any exception."""
        try:
            yield
        except ReceiverError:
            raise
        except self._library.VSSClientError as error:
            raise self._unreached(error) from None
        except Exception as error:
            text = f"{self._broker}: its answer cannot be understood: {type(error).__name__}"
            raise ReceiverError(f"{text}: {' '.join(str(error).split())[:200]}") from None

    def connect(self) -> None:
        """Connect to the databroker, and find the signals that the databroker knows."""
        with self._errors_as_ours():
            self._connect()

    def _connect(self) -> None:
        settings = self._settings
        token = None if settings.token is None else settings.token.read_text().strip()
        self._client = self._library.VSSClient(
            settings.host,
            settings.port,
            token=token,
            root_certificates=settings.ca,
            tls_server_name=settings.server_name,
            ensure_startup_connection=False,
        )
        self._client.connect()
        self._types = {path: kind for path in PATHS if (kind := self._type_of(path)) is not None}
        if not self._types:
            raise ReceiverError(f"{self._broker} does not know any of {', '.join(PATHS)}")
        self._say(f"{self._broker} takes {len(self._types)} signals")

    def _type_of(self, path: str) -> Any:
        """Return the data type of a signal. If the signal is unknown, return None and report the
        signal once."""
        try:
            return self._client.get_value_types([path], timeout=CALL_S)[path]
        except self._library.VSSClientError as error:
            if error.error.get("code") != 404:  # unknown signal
                raise
        if path not in self._reported:
            self._reported.add(path)
            hint = "; load config/imucald-vss.json into the broker" if path.startswith(OWN) else ""
            self._say(f"{self._broker} does not know {path}, so it is not sent{hint}")
        return None

    def publish(self, reading: Reading) -> None:
        """Send a reading."""
        self._set(vss_values(reading))

    def _set(self, values: Mapping[str, Any]) -> None:
        library = self._library
        updates = [
            library.EntryUpdate(
                library.DataEntry(
                    path,
                    value=library.Datapoint(value),
                    metadata=library.Metadata(data_type=self._types[path]),
                ),
                (library.Field.VALUE,),
            )
            for path, value in values.items()
            if path in self._types
        ]
        if not updates:
            return
        with self._errors_as_ours():
            self._client.set(updates, try_v2=True, timeout=CALL_S)

    def disconnect(self) -> None:
        """Disconnect from the databroker."""
        if self._client is not None:
            self._client.disconnect()
            self._client = None

    def close(self) -> None:
        """Set all values to not available, so that no old value looks like a present value."""
        if self._client is not None:
            try:
                self._set(dict.fromkeys(self._types))
            except ReceiverError as error:
                self._say(f"{error}; the broker keeps the last values")
            self.disconnect()

    @property
    def _broker(self) -> str:
        return f"KUKSA databroker {self._settings.host}:{self._settings.port}"

    def _unreached(self, error: Any) -> ReceiverError:
        found = error.error
        reason = found.get("message") or found.get("reason") or str(error)
        return ReceiverError(f"{self._broker}: {' '.join(str(reason).split())[:200]}")


def vss_values(reading: Reading) -> dict[str, Any]:
    """Return the values by VSS path; None means not available."""
    values: dict[str, Any] = {}
    for name, paths in VECTORS.items():
        if name in reading.corrected:
            found = reading.corrected[name]
            values |= zip(paths, (None, None, None) if found is None else found, strict=True)
    if reading.is_new:
        status = reading.status
        for path, of in _STATUS.items():
            values[path] = None if status is None else of(status)
    return values
