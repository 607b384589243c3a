"""Databases kept between runs: never anything else than what parsing would give."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from full_disk import full_after
from imucald.can.dbc import bounded_parser, database
from imucald.can.dbc.database import Database, load_database, load_database_text
from imucald.core import file_cache as database_cache
from imucald.core.errors import DatabaseError
from paths import ROOT

DATA = ROOT / "tests" / "data"
EXAMPLE = ROOT / "dbc" / "imucald_example.dbc"
FILES = [EXAMPLE, *sorted(DATA.glob("cluster.*"))]


@pytest.fixture(autouse=True)
def nothing_remembered():
    """Other tests of this process have read the same files."""
    database._remembered.cache_clear()


@pytest.fixture
def from_file(monkeypatch):
    """As a new process would: only the folder knows."""
    monkeypatch.setattr(database, "REMEMBERED_TEXT", -1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "cache"
    monkeypatch.setattr(database_cache._Cache, "folder", place)
    return place


@pytest.fixture
def parsed(monkeypatch):
    """Sources that were really parsed."""
    found: list[str] = []
    real = bounded_parser.parse_bounded

    def parse(text: str, database_format: str, source: str):
        found.append(source)
        return real(text, database_format, source)

    monkeypatch.setattr(bounded_parser, "parse_bounded", parse)
    return found


def same(a: Database, b: Database) -> bool:
    return dict(a.messages) == dict(b.messages)


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
@pytest.mark.usefixtures("from_file")
def test_a_kept_database_is_the_parsed_one(path, folder, parsed):
    first = load_database(path)
    assert same(load_database(path), first)
    assert parsed == [str(path)]
    assert folder.stat().st_mode & 0o777 == 0o700


def test_a_changed_file_is_parsed_again(tmp_path, folder, parsed):
    path = tmp_path / "a.dbc"
    text = EXAMPLE.read_text(encoding="cp1252")
    path.write_text(text, encoding="cp1252")
    load_database(path)
    stat = path.stat()
    path.write_text(text.replace("(0.002,0)", "(0.004,0)", 1), encoding="cp1252")
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # only the content tells
    assert load_database(path).signal("IMU_Accel.AccelX")[1].scale == 0.004
    assert len(parsed) == 2
    assert len(list(folder.iterdir())) == 1


def test_a_database_that_cannot_be_read_is_not_kept(folder):
    for _ in range(2):
        with pytest.raises(DatabaseError):
            load_database_text("BO_ nonsense", "dbc")
    assert not folder.exists()


@pytest.mark.usefixtures("from_file")
def test_other_versions_files_count_for_nothing(folder, parsed, monkeypatch):
    load_database(EXAMPLE)
    monkeypatch.setattr(database_cache, "_stamp", lambda: "another version")
    load_database(EXAMPLE)
    assert len(parsed) == 2


@pytest.mark.usefixtures("from_file")
def test_a_damaged_file_counts_for_nothing(folder, parsed):
    truth = load_database(EXAMPLE)
    (kept,) = folder.iterdir()
    whole = kept.read_bytes()
    rng = random.Random(1)
    for _ in range(60):
        damaged = bytearray(whole)
        damaged[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
        kept.write_bytes(
            rng.choice([bytes(damaged), whole[: rng.randrange(len(whole))], b"[" * 9999])
        )
        before = len(parsed)
        assert same(load_database(EXAMPLE), truth)
        assert len(parsed) == before + 1


@pytest.mark.usefixtures("from_file")
def test_a_folder_that_others_can_write_is_not_used(folder, parsed):
    load_database(EXAMPLE)
    folder.chmod(0o777)
    load_database(EXAMPLE)
    assert len(parsed) == 2


@pytest.mark.usefixtures("from_file")
def test_where_nothing_can_be_kept_databases_are_parsed(tmp_path, parsed, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    monkeypatch.setattr(database_cache._Cache, "folder", blocked / "cache")
    load_database(EXAMPLE)
    load_database(EXAMPLE)
    assert len(parsed) == 2


def test_the_cache_stays_small(folder, monkeypatch):
    monkeypatch.setattr(database_cache, "MAX_FILES", 3)
    text = EXAMPLE.read_text(encoding="cp1252")
    for number in range(6):
        load_database_text(text, "dbc", f"{number}.dbc")
    assert len(list(folder.iterdir())) == 3


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        (
            {"CACHE_DIRECTORY": "/var/cache/imucald/can0:/x", "HOME": "/root"},
            "/var/cache/imucald/can0",
        ),
        ({"XDG_CACHE_HOME": "/c", "HOME": "/h"}, "/c/imucald/databases"),
        ({"HOME": "/h"}, "/h/.cache/imucald/databases"),
        ({"XDG_CACHE_HOME": "relative"}, None),
        ({}, None),
    ],
)
def test_the_folder_is_systemds_or_the_users(environment, expected, folder):
    database_cache.keep_databases(environment)
    assert database_cache._Cache.folder == (None if expected is None else Path(expected))


def test_a_second_run_does_not_load_the_parser(tmp_path):
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 123#00\n")
    config = EXAMPLE.parent.parent / "config" / "examples" / "passenger_car.yaml"
    code = (
        "import sys; from imucald.cli import main\n"
        f"main(['replay', {str(log)!r}, '--config', {str(config)!r}, '--quiet'])\n"
        "print(any(name.startswith(('cantools', 'textparser')) for name in sys.modules))\n"
    )
    environment = {**os.environ, "CACHE_DIRECTORY": str(tmp_path / "cache")}
    outputs = [
        subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout.split()[-1]
        for _ in range(2)
    ]
    assert outputs == ["True", "False"]


def test_a_process_that_reads_many_logs_parses_a_database_once(tmp_path, parsed, monkeypatch):
    path = tmp_path / "car.dbc"
    path.write_bytes(EXAMPLE.read_bytes())
    first, again = load_database(path), load_database(path)
    assert again.messages == first.messages
    assert parsed == [str(path)]
    path.write_bytes(EXAMPLE.read_bytes().replace(b"IMU", b"XMU"))
    changed = load_database(path)
    assert parsed == [str(path)] * 2
    assert set(changed.messages) != set(first.messages)
    monkeypatch.setattr(database, "REMEMBERED_TEXT", 10)
    load_database(path)
    assert parsed == [str(path)] * 3


def test_a_process_remembers_few_databases(tmp_path, parsed):
    paths = [tmp_path / f"{k}.dbc" for k in range(database.REMEMBERED + 1)]
    for path in paths:
        path.write_bytes(EXAMPLE.read_bytes())
        load_database(path)
    load_database(paths[-1])
    assert len(parsed) == len(paths)
    load_database(paths[0])
    assert parsed[len(paths) :] == [str(paths[0])]


def test_a_file_that_holds_nothing_is_read_as_nothing_whatever_is_remembered(tmp_path):
    path = tmp_path / "empty.dbc"
    path.write_text("")
    for _ in range(2):
        with pytest.raises(DatabaseError):
            load_database(path)
    load_database(EXAMPLE)
    with pytest.raises(DatabaseError):
        load_database(path)


def test_a_full_disk_is_not_filled_by_unfinished_files(folder):
    for _ in range(3):  # as many starts
        with full_after(5000):
            load_database(EXAMPLE)
        database._remembered.cache_clear()
    assert list(folder.iterdir()) == []
    load_database(EXAMPLE)
    assert [path.suffix for path in folder.iterdir()] == [".json"]


def test_what_a_killed_process_left_unfinished_is_removed_and_nothing_else(folder):
    folder.mkdir(mode=0o700)
    now = time.time()
    ages = {"feb9c5c9.10811": 3600.0, "feb9c5c9.10812": -3600.0, "feb9c5c9.10813": 5.0}
    others = dict.fromkeys(("starts", "feb9c5c9.10811.txt", "notes.1", "feb9c5c9.json"), 9e6)
    for name, age in (ages | others).items():
        (folder / name).write_text("half")
        os.utime(folder / name, (now - age, now - age))
    (folder / "aaaaaaaa.1").mkdir()
    os.utime(folder / "aaaaaaaa.1", (0, 0))
    load_database(EXAMPLE)
    left = {path.name for path in folder.iterdir()}
    assert left >= {"feb9c5c9.10813", "aaaaaaaa.1", *others}
    assert not left & {"feb9c5c9.10811", "feb9c5c9.10812"}
