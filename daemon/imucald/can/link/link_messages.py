"""What a bus link says to people: what is wrong, and the remedy."""

from __future__ import annotations

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK


def absent_text(interface: str, channel: str, error: OSError) -> str:
    """Return the text for an interface that cannot be opened now."""
    if interface != "socketcan":
        return f"{error}: is it plugged in, and is the channel's name right?"
    return (
        f"no CAN interface {channel} here ({error.strerror or error}). Remedy: name one of those "
        f"that `ip link show type can` lists, or for a trial: "
        f"ip link add dev {channel} type vcan && ip link set up {channel}"
    )


def down_text(channel: str) -> str:
    """Return the text for an interface that exists and is set down."""
    return (
        f"{channel} is set down. Remedy: ip link set up {channel} "
        "(a real interface needs its bit rate first: type can bitrate ...)"
    )


def bus_off_text(channel: str) -> str:
    """Return the text for a controller that has left the bus."""
    return (
        f"the controller of {channel} is bus-off (wrong bit rate, wiring, or no other node); "
        f"to restart by itself: ip link set {channel} type can restart-ms 100"
    )


def conflict_text(channel: str, can_id: int) -> str:
    """Return the text for a frame of another node under one of our output ids."""
    digits = 8 if can_id & CAN_EFF_FLAG else 3
    return (
        f"another node on {channel} sends our output id {can_id & CAN_EFF_MASK:0{digits}X}: "
        "choose other ids for the output, or stop the other sender"
    )


def queue_full_text(channel: str) -> str:
    """Return the text for frames dropped because the interface does not take them."""
    return (
        f"the send queue of {channel} is full and frames are dropped: nobody acknowledges them, "
        f"or it is too short (ip link set {channel} txqueuelen 100)"
    )
