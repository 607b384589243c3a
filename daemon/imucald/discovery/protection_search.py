"""Find alive counters and checksums of a message by testing them on its frames.

A checksum of eight bits fits a frame by chance with a probability of 1/256. A checksum is therefore
accepted only if it fits nearly all of at least 20 different frames. Unknown data ids of AUTOSAR E2E
profiles need no search: a CRC is linear, so an id contributes the same number to the checksum of
every frame. If ids alternate, the contribution is the same for all frames with one counter value.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.bits import Field, field_of, read_column, words_of
from imucald.can.dbc.message import Message
from imucald.can.e2e.checksum_engine import Checksum, ChecksumSpec
from imucald.can.e2e.checksums import KINDS, DataIdMode
from imucald.core.errors import ConfigError
from imucald.discovery.candidates import MessageTraffic
from imucald.discovery.proposal import ProtectionFound

MAX_FRAMES = 20_000
MIN_DIFFERENT = 20
"""Smallest number of different frames, so that a fit cannot be chance (256^-20)."""
FITS = 0.99
"""Share of the frames that a checksum must fit. A recording may contain damaged frames."""
COUNTS = 0.9
"""Share of the frames in which a counter must increase by 1. A tenth of the frames may be lost."""
ID_BYTES = (0, 2, 4, 1)
"""Numbers of identifier bytes at the start of a checksum's input, the most frequent first."""


Columns = NDArray[np.uint8]


@dataclass(frozen=True)
class _Options:
    """The options that `ChecksumKind.make` reads."""

    signal: str | None = None
    id_bytes: int = 0
    offset: int = 0
    data_id: int | tuple[int, ...] | None = None
    data_id_mode: DataIdMode = "both"


def find_protection(one: MessageTraffic) -> ProtectionFound | None:
    """Find the counter and the checksum of a message; None if the message has neither."""
    whole = one.length == one.message.length
    data = one.data[whole][:MAX_FRAMES]
    if len(data) < MIN_DIFFERENT or data.shape[1] < one.message.length:
        return None
    settings: dict[str, Any] = {}
    evidence: dict[str, str] = {}
    counter = _counter(one, data)
    if counter is not None:
        settings["counter"], evidence["counter"] = counter
    is_varied = len({row.tobytes() for row in data}) >= MIN_DIFFERENT
    checksum = _checksum_in_signal(one, data) if is_varied else None
    if checksum is None and is_varied:
        checksum = next(_e2e(one.message, data), None)
        if checksum is not None:  # its profile defines the counter
            settings.pop("counter", None)
            evidence.pop("counter", None)
    if checksum is not None:
        settings["checksum"], evidence["checksum"] = checksum
    return ProtectionFound(one.message.name, settings, evidence) if settings else None


def _counter(one: MessageTraffic, data: Columns) -> tuple[dict[str, Any], str] | None:
    best: tuple[float, dict[str, Any], str] | None = None
    for name, signal in one.message.signals.items():
        whole = not signal.is_float and not signal.is_signed and not signal.selectors
        if not whole or not 2 <= signal.length <= 16:
            continue
        field = field_of(signal)
        if field.first_bit < 0 or field.end_byte > one.message.length:
            continue
        values = read_column(words_of(data, field.byte_order), field).astype(np.int64)
        full, seen = 1 << signal.length, int(values.max()) + 1
        for modulus in dict.fromkeys((full, seen)):
            if not full // 2 < modulus <= full or modulus < 3:
                continue
            share = float(np.mean(np.diff(values) % modulus == 1))
            if share >= COUNTS and len(np.unique(values)) > modulus // 2:
                settings: dict[str, Any] = {"signal": name}
                if modulus != full:
                    settings["modulus"] = modulus
                text = f"counts up by one in {_percent(share)} of {len(values)} frames"
                if best is None or share > best[0]:
                    best = share, settings, text
    return None if best is None else best[1:]


def _checksum_in_signal(one: MessageTraffic, data: Columns) -> tuple[dict[str, Any], str] | None:
    # each byte is the XOR of all others: the last one is probably the checksum
    for name, signal in sorted(
        one.message.signals.items(),
        key=lambda item: -field_of(item[1]).first_bit,
    ):
        if signal.length != 8 or signal.is_float:
            continue
        field = field_of(signal)
        if field.first_bit % 8 or field.first_bit < 0 or field.end_byte > one.message.length:
            continue
        if len(np.unique(data[:, field.first_bit // 8])) < MIN_DIFFERENT:
            continue
        for kind in ("crc8_j1850", "xor"):
            for id_bytes in ID_BYTES:
                options = _Options(signal=name, id_bytes=id_bytes)
                share = _share(KINDS[kind].make(one.message, options), data)
                if share >= FITS:
                    settings: dict[str, Any] = {"kind": kind, "signal": name}
                    if id_bytes:
                        settings["id_bytes"] = id_bytes
                    return settings, f"fits {_percent(share)} of {len(data)} frames"
    return None


def _share(spec: ChecksumSpec, data: Columns) -> float:
    checksum = Checksum(spec)
    if not checksum.are_right(data[:50]).any():
        return 0.0
    return float(np.mean(checksum.are_right(data)))


def _e2e(message: Message, data: Columns) -> Iterator[tuple[dict[str, Any], str]]:
    """Yield the settings of each E2E profile that fits with any data id."""
    for offset in range(message.length - 1):
        if len(np.unique(data[:, offset])) < MIN_DIFFERENT:
            continue
        for kind, data_ids in (("e2e_p1", _ids_1), ("e2e_p2", _ids_2), ("e2e_p5", _ids_5)):
            spec = partial(_e2e_spec, message, kind, offset)
            try:
                counter = _header_counter(kind, offset, data)
                found = None if counter is None else data_ids(spec, counter, data)
            except ConfigError:  # the header does not fit at this place
                continue
            if found is not None and (share := _share(spec(**found), data)) >= FITS:
                settings = {"kind": kind, **found, **({"offset": offset} if offset else {})}
                text = f"fits {_percent(share)} of {len(data)} frames"
                if found.get("data_id_mode") == "low":
                    text += "; other ids and modes give the same checksum, so check the id in the "
                    text += "data sheet"
                yield settings, text


def _e2e_spec(
    message: Message,
    kind: str,
    offset: int,
    data_id: int | list[int],
    data_id_mode: DataIdMode = "both",
) -> ChecksumSpec:
    ids = tuple(data_id) if isinstance(data_id, list) else data_id
    return KINDS[kind].make(message, _Options(None, 0, offset, ids, data_id_mode))


Spec = Callable[..., ChecksumSpec]


def _ids_1(spec: Spec, counter: NDArray[np.int64], data: Columns) -> dict[str, Any] | None:
    ids = _contributions(lambda i: spec(data_id=i, data_id_mode="low"), 8)
    added = _added(spec(data_id=0, data_id_mode="low"), data)
    found = ids.get(_common(added))
    if found is not None:
        return {"data_id": found, "data_id_mode": "low"}
    even, odd = (ids.get(_common(added[counter % 2 == parity])) for parity in (0, 1))
    if even is None or odd is None:
        return None
    return {"data_id": even | odd << 8, "data_id_mode": "alternating"}


def _ids_2(spec: Spec, counter: NDArray[np.int64], data: Columns) -> dict[str, Any] | None:
    ids = _contributions(lambda i: spec(data_id=[i] * 16), 8)
    added = _added(spec(data_id=[0] * 16), data)
    found = [ids.get(_common(added[counter == value])) for value in range(16)]
    return None if None in found else {"data_id": found}


def _ids_5(spec: Spec, _: NDArray[np.int64], data: Columns) -> dict[str, Any] | None:
    ids = _contributions(lambda i: spec(data_id=i), 16)
    found = ids.get(_common(_added(spec(data_id=0), data)))
    return None if found is None else {"data_id": found}


def _contributions(spec: Callable[[int], ChecksumSpec], bits: int) -> dict[int | None, int]:
    """Return the ids by their contribution to the checksum of any frame, without ids that share
    one. The contribution of an id is the sum over its bits."""
    zero = bytes(spec(0).size)
    made = np.zeros(1, np.uint16)
    for bit in range(bits):
        one = Checksum(spec(1 << bit)).compute(zero) ^ Checksum(spec(0)).compute(zero)
        made = np.concatenate([made, made ^ np.uint16(one)])
    numbers, first, count = np.unique(made, return_index=True, return_counts=True)
    alone = count == 1
    return dict(zip(numbers[alone].tolist(), first[alone].tolist(), strict=True))


def _header_counter(kind: str, offset: int, data: Columns) -> NDArray[np.int64] | None:
    """Return the counter (N,) of an E2E header that begins at this byte of the frame; None if it
    does not count up."""
    header = KINDS[kind].counter
    assert header is not None, "every E2E profile has a counter"
    field = Field(8 * offset + header.bit, header.length, "little_endian")
    if field.end_byte > data.shape[1]:
        return None
    values = read_column(words_of(data, "little_endian"), field).astype(np.int64)
    steps = np.mean(np.diff(values) % header.modulus == 1)
    return values if steps >= COUNTS and int(values.max()) < header.modulus else None


def _added(spec: ChecksumSpec, data: Columns) -> NDArray[np.uint16]:
    """Return the XOR difference (N,) between the stored checksums and checksums without an id."""
    checksum = Checksum(spec)
    return checksum.stored_columns(data) ^ checksum.compute_columns(data)


def _common(values: NDArray[np.uint16]) -> int | None:
    """Return the number that nearly all values equal; None if there is no such number."""
    if len(values) < 3:
        return None
    numbers, counts = np.unique(values, return_counts=True)
    most = int(counts.argmax())
    return int(numbers[most]) if counts[most] >= FITS * len(values) else None


def _percent(share: float) -> str:
    return "all" if share == 1.0 else f"{100.0 * share:.4g} %"
