"""A raw SocketCAN socket, read in batches: kernel filters, kernel time stamps, counted losses.

python-can is used for every other interface (see link.py). On a busy bus, our own socket needs less
processor time and gives more exact time stamps. Filters are set before the socket is bound, so
unwanted frames are never queued. `SO_RXQ_OVFL` gives the number of our frames that the kernel
dropped. Reading a frame takes one system call and creates only a tuple.

The code uses these facts about the kernel (net/can/raw.c). If the interface goes down, its socket
gets ENETDOWN once and stays bound, so frames resume without action. If the interface is deleted,
the socket gets ENODEV and is no longer bound. The socket then receives nothing, even if an
interface of the same name is created. The error is reported before the waiting frames. The number
of dropped frames would be reported only with the next frame. Therefore, before a socket is closed
after such an error, its waiting frames and the number of dropped frames are read.
"""

from __future__ import annotations

import errno
import os
import select
import socket
import struct
import time
from collections.abc import Sequence
from contextlib import suppress

from imucald.can.columns import (
    CAN_ERR_FLAG,
    CAN_RTR_FLAG,
    CANFD_BRS,
    CANFD_FDF,
    CLASSIC_BYTES,
    FD_LENGTHS,
    IdMatch,
)
from imucald.core.errors import LinkError

try:
    import fcntl
except ImportError:  # on Windows, which can only read logs
    fcntl = None  # type: ignore[assignment]

Frame = tuple[float, int, bytes]
"""Kernel time stamp [s, whole microseconds], id with the kernel's flags, payload."""

CAN_ERR_BUSOFF = 0x0000_0040
CAN_ERR_RESTARTED = 0x0000_0100
CAN_ERR_CONTROLLER = 0x0000_0004

MAX_FILTERS = 512
"""CAN_RAW_FILTER_MAX of the kernel. With more ids, all frames are received."""

MAX_BATCH = 1024
"""Largest number of frames read in one call, so that a flooded bus does not block sending."""

_SO_RXQ_OVFL = 40
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_SO_MEMINFO = 55
_MEMINFO = struct.Struct("@9I")
"""Layout of a socket's memory information (linux/sock_diag.h). The last number counts the frames
that the kernel dropped, as in `SO_RXQ_OVFL`."""
_SIOCGIFFLAGS = 0x8913
_IFF_UP = 1
_FILTER = struct.Struct("=II")
_CLASSIC = struct.Struct("=IB3x8s")
_FD = struct.Struct("=IBBxx64s")
_TIMESPEC = struct.Struct("@ll")
_DROPS = struct.Struct("@I")
_FLAGS_REQUEST = struct.Struct("@16sH14x")


class SocketCan:
    """One bound raw socket. Every `OSError` of the kernel is raised; the link handles it.

    Raises LinkError if opening can never work (no CAN in the kernel, not a CAN interface). Raises
    OSError with ENODEV if there is no such interface now.
    """

    def __init__(
        self,
        channel: str,
        matches: Sequence[IdMatch],
        *,
        fd: bool = False,
        receive_buffer: int = 0,
    ) -> None:
        self._channel = channel
        self.index = _interface_index(channel)
        self.lost = 0
        """Number of unread frames: dropped by the kernel or lost with the abandoned socket."""
        self.rejected, self.why_rejected = 0, ""  # the kernel returns only valid frames
        self._drops = 0
        self._fault: OSError | None = None
        self._socket = _raw_socket()
        try:
            self._set_up(matches, fd, receive_buffer)
            self._socket.bind((channel,))
        except OSError as error:
            self._socket.close()
            if error.errno == errno.ENODEV and _interface_index(channel) == self.index:
                raise LinkError(f"{channel} is not a CAN interface (see: ip -d link)") from None
            raise
        self.receive_buffer = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        """Size of the kernel's receive buffer [bytes, including overhead]."""
        self._poll = select.poll()
        self._poll.register(self._socket, select.POLLIN)

    def _set_up(self, matches: Sequence[IdMatch], fd: bool, receive_buffer: int) -> None:
        sock = self._socket
        sock.setblocking(False)
        sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, packed_filters(matches))
        classes = CAN_ERR_BUSOFF | CAN_ERR_RESTARTED | CAN_ERR_CONTROLLER
        sock.setsockopt(socket.SOL_CAN_RAW, 2, classes)  # CAN_RAW_ERR_FILTER
        sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 0)
        sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_LOOPBACK, 1)  # other programs here
        sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        if fd:
            sock.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        if receive_buffer:
            try:  # exceeds the system's limit if we have the right
                sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, receive_buffer)
            except OSError:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)

    def fileno(self) -> int:
        """Return the socket's descriptor, readable when frames wait."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def receive(self, timeout: float) -> list[Frame]:
        """Wait up to `timeout` [s] for a frame, then return all waiting frames (bounded).

        Raises OSError if the interface is down or gone. The kernel reports such an error once.
        Frames that were read in the same batch are returned first.
        """
        if self._fault is not None:
            fault, self._fault = self._fault, None
            raise fault
        if not self._poll.poll(max(0.0, timeout * 1e3)):
            return []
        frames: list[Frame] = []
        recvmsg, add = self._socket.recvmsg, frames.append
        ancillary_bytes = sum(socket.CMSG_SPACE(part.size) for part in (_TIMESPEC, _DROPS))
        while len(frames) < MAX_BATCH:
            try:
                raw, ancillary, _, _ = recvmsg(_FD.size, ancillary_bytes)
            except BlockingIOError:
                break
            except OSError as error:
                if not frames:
                    raise
                self._fault = error
                break
            add((self._stamp(ancillary), *_unpacked(raw)))
        return frames

    def _stamp(self, ancillary: list[tuple[int, int, bytes]]) -> float:
        """Return the kernel's time stamp [s], and count the drops that it reports.

        The stamp is cut to microseconds and divided once. The double is then equal to the time that
        candump records for the same frame.
        """
        stamp = 0.0
        for _, kind, content in ancillary:
            if kind == _SO_TIMESTAMPNS:
                seconds, nanoseconds = _TIMESPEC.unpack(content)
                stamp = (seconds * 1_000_000 + nanoseconds // 1000) / 1e6
            elif kind == _SO_RXQ_OVFL:
                (drops,) = _DROPS.unpack(content)
                if drops != self._drops:
                    self._count_drops(drops)
        return stamp or time.time()

    def _count_drops(self, drops: int) -> None:
        self.lost += (drops - self._drops) & 0xFFFF_FFFF
        self._drops = drops

    def give_up(self) -> None:
        """Count as lost the waiting frames and the drops that the kernel has not reported."""
        for _ in range(self.receive_buffer // _CLASSIC.size):  # more than the buffer holds
            try:
                self._socket.recv(_FD.size)
            except BlockingIOError:
                break
            except OSError:  # told once
                continue
            self.lost += 1
        with suppress(OSError, struct.error):  # not supported before Linux 4.12
            memory = self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
            self._count_drops(_MEMINFO.unpack(memory)[-1])

    def send(self, can_id: int, data: bytes) -> None:
        """Pass one frame to the kernel, as CAN FD if it is longer than 8 bytes.

        Raises OSError: ENOBUFS or EAGAIN if the transmit queue is full, ENETDOWN, ENODEV, ENXIO.
        """
        if len(data) <= CLASSIC_BYTES:
            self._socket.send(_CLASSIC.pack(can_id, len(data), data))
            return
        length = next(size for size in FD_LENGTHS if size >= len(data))
        self._socket.send(_FD.pack(can_id, length, CANFD_FDF | CANFD_BRS, data))

    def is_same_interface(self) -> bool:
        """True if the interface of our socket is still the one with this name."""
        try:
            return _interface_index(self._channel) == self.index
        except OSError:
            return False

    def is_up(self) -> bool:
        """True if the interface is up. The ioctl uses our socket, so no socket of another family is
        needed."""
        request = _FLAGS_REQUEST.pack(os.fsencode(self._channel), 0)
        try:
            answer = fcntl.ioctl(self._socket, _SIOCGIFFLAGS, request)
        except OSError:
            return False
        return bool(_FLAGS_REQUEST.unpack(answer)[1] & _IFF_UP)


def packed_filters(matches: Sequence[IdMatch]) -> bytes:
    """Return the kernel's filter list for data frames with these ids. Without ids, no frame passes.

    Remote frames contain no data, so they are excluded. With more ids than the kernel accepts, all
    frames pass.
    """
    if len(matches) > MAX_FILTERS:
        return _FILTER.pack(0, 0)
    return b"".join(
        _FILTER.pack(m.can_id & ~CAN_ERR_FLAG, m.full_mask & ~CAN_ERR_FLAG | CAN_RTR_FLAG)
        for m in dict.fromkeys(matches)
    )


def _unpacked(raw: bytes) -> tuple[int, bytes]:
    if len(raw) == _CLASSIC.size:
        can_id, length, data = _CLASSIC.unpack(raw)
        return can_id, data[:length]
    can_id, length, _, data = _FD.unpack(raw)
    return can_id, data[:length]


def _interface_index(channel: str) -> int:
    """Return the kernel's index of the interface. Raises OSError ENODEV if there is none."""
    try:
        return socket.if_nametoindex(channel)
    except OSError:
        raise OSError(errno.ENODEV, f"no interface {channel}") from None


def _raw_socket() -> socket.socket:
    try:
        return socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except (AttributeError, OSError) as error:
        raise LinkError(
            f"this system offers no SocketCAN ({error}): load the kernel module can_raw, "
            "or use another python-can interface"
        ) from None
