"""The process that children are copied from: it has imported everything and does nothing else.

    python -m imucald.fleet.template DESCRIPTOR FUNCTION

A copy starts in milliseconds where a new interpreter takes a third of a second. It has one thread
and touches no data, so that a copy begins clean whatever happened to the logs before it. Through
the socket comes one descriptor per task, on which a keeper answers.
"""

from __future__ import annotations

import gc
import os
import select
import socket
import sys

from imucald.fleet.child_guard import function_of, keep

LOOK_S = 1.0
"""Each second it looks whether its worker still lives, should the socket be held open elsewhere."""


def main(descriptor: int, function: str) -> None:
    """Serve until the worker closes the socket or ends."""
    worker = os.getppid()
    control = socket.socket(fileno=descriptor)
    function_of(function)
    gc.collect()
    gc.freeze()  # shared pages stay shared: the collector does not touch what is here
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
    """Fork a keeper for the next task; False where there will be none any more."""
    try:
        message, descriptors, _, _ = socket.recv_fds(control, 1, 1)
    except OSError:  # the worker ended with our word unread
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
