"""Files that are made to hang or to kill whoever reads them: refused with a reason, and soon."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from imucald.config import load_config
from imucald.core.errors import ConfigError, DatabaseError
from imucald.core.files import read_regular
from imucald.core.yaml_parser import parse_yaml
from imucald.inputs.wiring import compile_router

LIMIT_S = 20.0
CHECK = [sys.executable, "-m", "imucald", "check", "nothing.log", "--config"]


def message_of(configuration: Path, memory: int = 1 << 30) -> tuple[int, str]:
    """Status and standard error of a command that reads a configuration, in bounded memory."""
    command = ["prlimit", f"--data={memory}", *CHECK, str(configuration)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
        cwd=configuration.parent,
        env=environment,
    )
    return done.returncode, done.stderr


@pytest.fixture
def log(tmp_path):
    (tmp_path / "nothing.log").touch()


@pytest.mark.parametrize("text", ["[" * 30_000, "{" * 30_000, "- " * 30_000, "? " * 30_000])
def test_brackets_without_end_are_one_line_and_no_crash(text, tmp_path, log):
    path = tmp_path / "deep.yaml"
    path.write_text("a: " + text if text[0] in "[{" else text)
    status, message = message_of(path)
    assert status == 1, "a signal is a crash"
    assert message.count("\n") == 1
    assert "deep.yaml:1: nested too deeply" in message


def test_a_pipe_that_nobody_writes_to_is_not_waited_for(tmp_path, log):
    path = tmp_path / "pipe.yaml"
    os.mkfifo(path)
    status, message = message_of(path)
    assert (status, message.count("\n")) == (1, 1)
    assert "not a regular file" in message


def test_a_device_without_end_is_refused(tmp_path, log):
    path = tmp_path / "zero.yaml"
    path.symlink_to("/dev/zero")
    status, message = message_of(path)
    assert (status, message.count("\n")) == (1, 1)
    assert "not a regular file" in message


def test_no_more_is_read_than_is_asked_for(tmp_path):
    path = tmp_path / "long"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # a hole of a terabyte
    assert len(read_regular(path, 1000)) == 1001
    with pytest.raises(IsADirectoryError):
        read_regular(tmp_path, 1000)
    with pytest.raises(OSError, match="not a regular file") as error:
        read_regular(Path("/dev/null"), 1000)
    assert error.value.errno == errno.EINVAL


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("".join(f"key{i}: 1\n" for i in range(75_000)), "more keys and values"),
        ("a: [" + "1," * 400_000 + "]", "more keys and values"),
        ("a: 1" + ":1" * 400_000, "a number of 800001 characters"),
        ("a: " + "9" * 900_000, "a number of 900000 characters"),
        ("a: 1" + ":1" * 400_000 + ".5", "a number of 800003 characters"),
    ],
    ids=["keys", "items", "base 60", "digits", "base 60 fraction"],
)
def test_a_file_of_a_megabyte_is_judged_in_a_second(text, reason):
    began = time.process_time()
    with pytest.raises(ConfigError, match=reason):
        parse_yaml(text, "long.yaml")
    assert time.process_time() - began < 1.0


def test_a_database_with_a_name_that_no_file_can_have_is_one_line(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text('database: "a\\0b.dbc"\nsignals: {accelerometer: {x: M.X, y: M.Y, z: M.Z}}\n')
    loaded = load_config(path)
    with pytest.raises((ConfigError, DatabaseError)):
        compile_router(loaded)
