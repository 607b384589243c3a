"""List the quantities that were not found, with the most likely reason."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set

from imucald.can.dbc.database import Database
from imucald.can.dbc.decode import compile_decode, id_match
from imucald.can.dbc.message import Message
from imucald.can.j1939_transport import in_transport
from imucald.core.errors import DatabaseError
from imucald.core.samples import QUANTITIES, TEMPERATURE
from imucald.discovery.candidates import MessageTraffic, SeenSignal, misses_sign
from imucald.discovery.names import named_so


def not_found(
    found: Set[str],
    used: Set[str],
    databases: Mapping[str, Database],
    messages: Mapping[str, MessageTraffic],
    candidates: Sequence[SeenSignal],
    announced: Mapping[int, int],
) -> dict[str, str]:
    """Return, for each missing quantity, the reason why a signal with a similar name was not used.

    The reason is empty if no signal has such a name. used: paths of signals used for another
    quantity. announced: messages announced by J1939 transport frames, see `announced_messages`.
    """
    seen = {c.path: c for c in candidates}
    reasons = {}
    for quantity in (row.key for row in QUANTITIES.values()):
        if quantity not in found and quantity != "magnetometer":  # which is rare
            named = _named(quantity, databases)
            why = (
                _why(quantity, message, name, messages, seen, announced)
                for message, name in named
                if f"{message.name}.{name}" not in used
            )
            reasons[quantity] = next(filter(None, why), "")
    return reasons


def _named(quantity: str, databases: Mapping[str, Database]) -> Iterator[tuple[Message, str]]:
    for database in databases.values():
        for message in database.messages.values():
            yield from ((message, name) for name in message.signals if named_so(quantity, name))


def _why(
    quantity: str,
    message: Message,
    name: str,
    messages: Mapping[str, MessageTraffic],
    seen: Mapping[str, SeenSignal],
    announced: Mapping[int, int],
) -> str:
    path = f"{message.name}.{name}"
    if path in seen:
        return f"{path} {_why_not_chosen(quantity, seen[path])}"
    try:
        plan = compile_decode(message, [name])
        id_match(message)
    except DatabaseError as error:
        return f"{path} cannot be read: {error}"
    traffic = messages.get(message.name)
    if traffic is None:
        match = id_match(message, j1939=True)
        sizes = [size for can_id, size in announced.items() if match.matches(can_id, "")]
        return f"{message.name} does not come" + (f": {in_transport(max(sizes))}" if sizes else "")
    longest = int(traffic.length.max())
    if longest < message.length:
        return (
            f"the frames of {message.name} have {longest} bytes, but the database says "
            f"{message.length}"
        )
    decoded = plan.decode_columns(traffic.data, traffic.length)
    if misses_sign(message.signal(name), decoded.raw[0][decoded.ok]):
        return (
            f"{path} is signed according to its values, but unsigned in the database: in a DBC, "
            "change '+' to '-' behind '@0' or '@1' of its line"
        )
    return f"{path} has no usable value"


def _why_not_chosen(quantity: str, signal: SeenSignal) -> str:
    if signal.is_constant:
        return "never changes"
    if quantity == TEMPERATURE.key and signal.states("temperature"):
        return "may be the temperature of another part"
    unit = f" (its unit is '{signal.unit}')" if signal.unit else ""
    if quantity == TEMPERATURE.key:
        return f"has no unit of temperature{unit}"
    return f"does not follow the motion in any unit of this quantity{unit}"
