"""The template process and its keepers. The template process imports all modules and waits. Child
processes are forked from it.

    python -m imucald.fleet.template DESCRIPTOR FUNCTION

A forked copy starts in milliseconds; a new interpreter takes a third of a second. The template has
one thread and touches no data, so each copy starts in a clean state, independent of earlier logs.
For each task, the template receives a file descriptor through the socket and forks a keeper, and
the keeper forks the child that evaluates the log. A child may hang, use too much memory or crash in
C code. The keeper only waits for the child, so it can report all these failures through the
descriptor. Each process ends when the process that started it ends.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import gc
import importlib
import os
import resource
import select
import signal
import socket
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from typing import NoReturn

import msgspec

from imucald.fleet.task import Cost, Outcome, Task

LOOK_S = 1.0
"""Period of the check whether the worker process still exists [s]. The check is needed if another
process keeps the socket open."""
MAX_ANSWER = 64 * 2**20
"""Largest accepted answer of a child [bytes]. The events of a whole day need far fewer bytes."""
LAST_WORDS = 4000
"""Number of bytes at the end of standard error that are kept."""
DYING_S = 5.0
"""Longest wait for the end of a killed child [s]. A process that waits for storage does not end at
once."""
BLOCK = 2**16


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


def keep(asked: socket.socket, template: int) -> NoReturn:
    """Run the task received from the socket, send the outcome through the socket, and end this
    process."""
    status = 1
    try:
        die_with(template)
        task = msgspec.json.decode(_whole(asked), type=Task)
        asked.sendall(msgspec.json.encode(_guarded(task, asked)))
        status = 0
    finally:
        os._exit(status)


def _whole(asked: socket.socket) -> bytes:
    blocks = []
    while block := asked.recv(BLOCK):
        blocks.append(block)
    return b"".join(blocks)


def _guarded(task: Task, asked: socket.socket) -> Outcome:
    """Run the task in a child whose temporary files are removed even if the child is killed: a
    fetched log may have gigabytes."""
    with tempfile.TemporaryDirectory(prefix="imucald-child-", ignore_cleanup_errors=True) as folder:
        return _limited(task, asked, folder)


def _limited(task: Task, asked: socket.socket, folder: str) -> Outcome:
    began = time.monotonic()
    words = os.memfd_create("last words")
    answers, answer = os.pipe()
    keeper = os.getpid()
    child = os.fork()
    if child == 0:
        os.close(answers)
        asked.close()
        tempfile.tempdir = folder
        _become_child(task, keeper, answer, words)
    os.close(answer)
    with contextlib.suppress(OSError):
        os.setpgid(child, child)  # the child does so too; the first call counts
    answered, ended = _watch(child, answers, asked, began + task.limits.time_s)
    os.killpg(child, signal.SIGKILL)
    usage = _reaped(child)
    if usage is None:
        text = f"it did not end within {DYING_S:g} s after its time limit"
        return Outcome("timeout", f"{text}: its storage does not answer")
    status, cpu_s, peak = usage
    cost = Cost(time.monotonic() - began, cpu_s, peak)
    outcome = _verdict(answered, ended, status, task, _last_words(words))
    return msgspec.structs.replace(outcome, cost=cost)


def _watch(child: int, answers: int, asked: socket.socket, until: float) -> tuple[bytes, bool]:
    """Return the child's answer, and whether the child ended by itself within its time limit."""
    poll = select.poll()
    poll.register(answers, select.POLLIN)
    poll.register(asked, select.POLLHUP | select.POLLERR)
    answer = bytearray()
    while (left := until - time.monotonic()) > 0.0 and len(answer) <= MAX_ANSWER:
        for descriptor, event in poll.poll(left * 1000.0):
            if descriptor == answers:
                block = os.read(answers, BLOCK)
                if not block:
                    return bytes(answer), True
                answer += block
            elif event & (select.POLLHUP | select.POLLERR):  # nobody waits for the answer
                os.killpg(child, signal.SIGKILL)
                raise SystemExit(1)
    return b"", False


def _reaped(child: int) -> tuple[int, float, int] | None:
    """Wait for the end of a child. Return exit status, processor time [s] and peak memory [bytes];
    None if the child does not end."""
    until = time.monotonic() + DYING_S
    while time.monotonic() < until:
        pid, status, usage = os.wait4(child, os.WNOHANG)
        if pid:
            return status, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024
        time.sleep(0.001)
    return None


def _last_words(words: int) -> str:
    size = os.fstat(words).st_size
    return os.pread(words, LAST_WORDS, max(size - LAST_WORDS, 0)).decode("utf-8", "replace")


def _verdict(answered: bytes, ended: bool, status: int, task: Task, words: str) -> Outcome:
    code = os.waitstatus_to_exitcode(status)
    if answered:
        try:
            return msgspec.json.decode(answered, type=Outcome)
        except msgspec.DecodeError:
            return Outcome("crashed", "its answer was cut off", exit_code=code)
    if not ended:
        return Outcome("timeout", f"took longer than {task.limits.time_s:g} s")
    if code == -signal.SIGKILL:
        text = "was killed from outside (SIGKILL): the memory of the machine was probably exhausted"
        return Outcome("memory", text, exit_code=code)
    name = signal.Signals(-code).name if code < 0 else f"exit status {code}"
    return Outcome("crashed", f"its process died: {name}", None, code, _stack(words))


def _stack(words: str) -> str:
    """Return the lines of standard error without lines with addresses, so that equal crashes give
    equal texts."""
    kept = [line for line in words.splitlines() if "0x" not in line]
    return "\n".join(kept)


def _become_child(task: Task, keeper: int, answer: int, words: int) -> NoReturn:
    """Evaluate the log, send the answer, and end the process. The function never returns to the
    code of the keeper."""
    try:
        with contextlib.suppress(OSError):
            os.setpgid(0, 0)
        die_with(keeper)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.dup2(words, 1)
        os.dup2(words, 2)
        faulthandler.enable(sys.__stderr__ or 2)
        limit_memory(task.limits.memory_bytes)
        data = msgspec.json.encode(_evaluated(task))
        while data:
            data = data[os.write(answer, data) :]
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    os._exit(0)


def _evaluated(task: Task) -> Outcome:
    try:
        return function_of(task.function)(task)
    except MemoryError:
        gc.collect()
        mebibytes = task.limits.memory_bytes / 2**20
        return Outcome(
            "memory", f"needed more than {mebibytes:g} MiB in addition to the program itself"
        )
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        return Outcome("bug", text, traceback=traceback.format_exc(limit=-12))


def function_of(name: str) -> Callable[[Task], Outcome]:
    """Return the function named by "module:name"."""
    module, _, attribute = name.partition(":")
    found: Callable[[Task], Outcome] = getattr(importlib.import_module(module), attribute)
    return found


def die_with(parent: int) -> None:
    """Let the kernel kill this process when its parent ends. parent: its process id."""
    pr_set_pdeathsig = 1  # linux/prctl.h
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:  # the parent ended before the line above
        os._exit(1)


def limit_memory(beside: int) -> None:
    """Limit the mapped memory of this process to its present size plus `beside` bytes. Disable core
    files."""
    with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123 - a lean start
        mapped = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + beside, mapped + beside))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2])
