"""The template process. The template process imports all modules and waits. Child processes are
forked from the template process.

    python -m imucald.fleet.template DESCRIPTOR FUNCTION

A forked copy starts in milliseconds; a new interpreter takes a third of a second. The template has
one thread and touches no data, so each copy starts in a clean state, independent of earlier logs.
For each task, the template receives a file descriptor through the socket. A keeper process sends
the answer through this descriptor.
"""

from __future__ import annotations

import gc
import os
import select
import socket
import sys

from imucald.fleet.child_guard import function_of, keep

LOOK_S = 1.0
"""Period of the check whether the worker process still exists [s]. The check is needed if another
process keeps the socket open."""


def main(descriptor: int, function: str) -> None:
    """Serve until the worker closes the socket or ends."""
    worker = os.getppid()
    control = socket.socket(fileno=descriptor)
    function_of(function)
    gc.collect()
    gc.freeze()  # shared pages stay shared: the collector leaves them alone
    try:
        control.sendall(b"r")
    except OSError:  # the worker ended meanwhile
        return
    poll = select.poll()
    poll.register(control, select.POLLIN)
    while os.getppid() == worker:
        if poll.poll(LOOK_S * 1000.0) and not _serve(control):
            return
        _reap()


def _serve(control: socket.socket) -> bool:
    """Fork a keeper for the next task. Return False if there will be no more tasks."""
    try:
        message, descriptors, _, _ = socket.recv_fds(control, 1, 1)
    except OSError:  # the worker ended without reading our message
        return False
    if not message:
        return False
    for descriptor in descriptors:
        if os.fork() == 0:
            template = os.getppid()
            control.close()
            keep(socket.socket(fileno=descriptor), template)
        os.close(descriptor)
    return True


def _reap() -> None:
    try:
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass
    except ChildProcessError:
        return


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
