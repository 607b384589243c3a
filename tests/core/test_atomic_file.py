"""A checked file is the old one or the new one, and damage shows."""

from __future__ import annotations

import errno
import hashlib
import os
from pathlib import Path

import pytest

from imucald.core.files import (
    free_name,
    read_regular,
    split_checksum,
    with_checksum,
    write_file,
)


def test_a_written_file_is_read_back_and_leaves_nothing_beside_it(tmp_path):
    path = tmp_path / "new" / "a"
    write_file(path, b"one")
    write_file(path, b"two")
    assert read_regular(path, 10) == b"two"
    assert [p.name for p in path.parent.iterdir()] == ["a"]


@pytest.mark.parametrize("step", ["fsync", "rename"])
def test_a_failed_write_keeps_the_old_file_and_removes_the_unfinished_one(
    tmp_path, monkeypatch, step
):
    path = tmp_path / "a"
    write_file(path, b"old")

    def full(*arguments):
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(*((os, "fsync") if step == "fsync" else ("pathlib.Path.replace",)), full)
    with pytest.raises(OSError, match="full"):
        write_file(path, b"new")
    monkeypatch.undo()
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_file_and_folder_are_forced_to_the_disk(tmp_path, monkeypatch):
    forced = []
    fsync = os.fsync

    def noted(descriptor):
        forced.append(str(Path(f"/proc/self/fd/{descriptor}").readlink()))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    write_file(tmp_path / "a", b"data")
    assert forced == [str(tmp_path / "a.tmp"), str(tmp_path)]


def test_no_more_than_asked_is_read_of_a_long_file(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"x" * 100)
    assert len(read_regular(path, 10)) == 11


def test_the_checksum_is_sha_256_of_the_body_and_any_damage_breaks_it():
    body = b'{"a": 1}\nsecond line'
    data = with_checksum("name 1", body)
    assert data == b"name 1 " + hashlib.sha256(body).hexdigest().encode() + b"\n" + body
    assert split_checksum(data) == (b"name 1", body, True)
    for i in range(len(b"name 1 "), len(data)):
        damaged = data[:i] + bytes([data[i] ^ 1]) + data[i + 1 :]
        assert not split_checksum(damaged)[2]
    assert not split_checksum(data[:-1])[2]
    assert not split_checksum(b"")[2]


def test_what_is_set_aside_replaces_nothing(tmp_path):
    path = tmp_path / "a"
    names = []
    for _ in range(3):
        target = free_name(path, "corrupt")
        target.write_bytes(b"")
        names.append(target.name)
    assert names == ["a.corrupt.1", "a.corrupt.2", "a.corrupt.3"]


def test_a_folder_in_the_place_of_a_file_is_set_aside_with_all_that_is_in_it(tmp_path):
    for place in (tmp_path / "a", tmp_path / "a.tmp"):
        place.mkdir()
        (place / "precious").write_bytes(b"1")
    write_file(tmp_path / "a", b"new")
    write_file(tmp_path / "a", b"newer")
    assert (tmp_path / "a").read_bytes() == b"newer"
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["a", "a.folder.1", "a.tmp.folder.1"]
    assert (tmp_path / "a.folder.1" / "precious").exists()
    assert (tmp_path / "a.tmp.folder.1" / "precious").exists()


def test_a_folder_that_cannot_be_set_aside_leaves_nothing_unfinished(tmp_path, monkeypatch):
    (tmp_path / "a").mkdir()

    def busy(*_):
        raise OSError(errno.EBUSY, "busy")

    monkeypatch.setattr(Path, "rename", busy)
    with pytest.raises(OSError, match="busy"):
        write_file(tmp_path / "a", b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["a"]
