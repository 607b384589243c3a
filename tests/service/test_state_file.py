"""The saved state survives kills, full disks and damage, and is never another car's."""

from __future__ import annotations

import errno
import hashlib
import math
import os
import random
import resource
import signal
import struct
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imucald.service.records import MAX_BYTES
from imucald.service.saved_state import LONGEST_DOUBT, StateKey, StateStore
from service_files import IDENTITY, KEY, SMALL, state

KILLS = 300
SUMS = {"sums": {"score": [0.123456] * 1500}}
"""As large as evidence gets: kills find a write under way."""
ACKNOWLEDGED = struct.Struct("<q")


def saved_twice(folder: Path) -> StateStore:
    store = StateStore(folder, KEY)
    store.save(state(1.0))
    store.save(state(2.0))
    return store


def load(folder: Path, key: StateKey = KEY):
    return StateStore(folder, key).load()


def encoded(key: StateKey, generation: int, content) -> bytes:
    return StateStore(Path(), key).encoded(generation, content)


def with_body(body: bytes, version: str = "2") -> bytes:
    head = f"imucald-state {version} {len(body)} {hashlib.sha256(body).hexdigest()}\n"
    return head.encode() + body


def test_the_newest_of_two_generations_is_loaded(tmp_path):
    for number in range(1, 6):
        StateStore(tmp_path, KEY)
        store = StateStore(tmp_path, KEY)
        store.load()
        store.save(state(float(number)))
        assert load(tmp_path).content == state(float(number))
    assert load(tmp_path).generation == 5
    assert len(list(tmp_path.iterdir())) == 2


def test_all_fields_come_back(tmp_path):
    full = state(
        3.5,
        state="usable",
        doubted=True,
        saved_at=1.7e9,
        offsets={"gyro_bias": [0.1, 0.2, 0.3]},
        shifts=({"at": 1.0, "angle_deg": 8.0},),
        evidence={"sums": [1.0, 2.0]},
        doubt="gravity is larger or smaller than before",
    )
    StateStore(tmp_path, KEY).save(full)
    assert load(tmp_path).content == full


def test_a_reason_of_any_length_is_saved_so_that_it_is_believed_again(tmp_path):
    StateStore(tmp_path, KEY).save(state(1.0, doubted=True, doubt="gravity " * 1000))
    loaded = load(tmp_path)
    assert loaded.problems == ()
    assert loaded.content.doubt == ("gravity " * 1000)[:LONGEST_DOUBT]


def test_a_number_of_numpy_is_saved_and_a_text_that_cannot_be_read_again_is_refused(tmp_path):
    store = StateStore(tmp_path, KEY)
    store.save(state(evidence={"a": np.float64(1.5)}))
    assert load(tmp_path).content.evidence == {"a": 1.5}
    with pytest.raises(ValueError, match="surrogates"):
        store.save(state(evidence={"a": "\udc80"}))
    assert load(tmp_path).problems == ()


def test_after_the_last_generation_that_is_read_one_can_be_saved(tmp_path):
    store = StateStore(tmp_path, KEY)
    store.path(2**53).write_bytes(encoded(KEY, 2**53, state(1.0)))
    store.path(2**53 - 1).write_bytes(encoded(KEY, 2**53 - 1, state(2.0)))
    assert load(tmp_path).content == state(2.0)


def test_only_the_first_version_may_lack_the_length(tmp_path):
    data = encoded(KEY, 1, state(1.0))
    head, _, body = data.partition(b"\n")
    kind, version, _, checksum = head.split(b" ")
    StateStore(tmp_path, KEY).path(1).write_bytes(
        b" ".join((kind, version, checksum)) + b"\n" + body
    )
    found = load(tmp_path)
    assert found.content is None
    assert "its checksum or its length is wrong" in found.problems[0]


def test_nothing_saved_is_no_state_and_no_problem(tmp_path):
    assert load(tmp_path / "none") == load(tmp_path)
    assert load(tmp_path).problems == ()


@pytest.mark.slow
def test_300_kills_at_random_instants_lose_nothing(tmp_path):
    """What was acknowledged is there, or something newer: in either generation.

    A kill comes some time into a save, the first of a process or a later one. How long a save takes
    is the disk's business, so the saves before it are counted, and they are the measure.
    """
    random.seed(4)
    generation, save_s, saves = 0, 0.01, 0
    for _ in range(KILLS):
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            os.close(reading)
            save_for_ever(tmp_path, writing)
        os.close(writing)
        acknowledged, whole, began = b"", random.randrange(3), time.monotonic()
        for _ in range(whole):
            acknowledged += os.read(reading, ACKNOWLEDGED.size)
            save_s = (time.monotonic() - began) / whole
        time.sleep(random.uniform(0.0, save_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        saves += whole
        while part := os.read(reading, 65536):
            acknowledged += part
        os.close(reading)
        told = [number for (number,) in ACKNOWLEDGED.iter_unpack(acknowledged)]
        assert len(told) >= whole
        generation = max(generation, *told, 0)
        loaded = load(tmp_path)
        assert loaded.problems == ()
        assert loaded.generation >= generation
        if loaded.content is not None:
            assert loaded.content.driven_s == loaded.generation
        assert loaded.content is not None or generation == 0
        generation = loaded.generation
    assert generation >= saves > KILLS // 2, "the kills came before anything was written"


def save_for_ever(folder: Path, writing: int) -> None:
    try:
        store = StateStore(folder, KEY)
        store.load()
        while True:
            store.save(state(float(store.generation + 1), evidence=SUMS))
            os.write(writing, ACKNOWLEDGED.pack(store.generation))
    finally:
        os._exit(1)


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda data: data[: len(data) // 2], "corrupt"),
        (lambda _: b"", "corrupt"),
        (lambda data: data[:-40] + bytes([data[-40] ^ 1]) + data[-39:], "corrupt"),
        (lambda data: data.replace(b"imucald-state 2", b"imucald-state 0", 1), "other-version"),
        (lambda data: data.replace(b"imucald-state 2", b"imucald-state 3", 1), "other-version"),
        (lambda _: os.urandom(500), "corrupt"),
        (lambda data: bytes(len(data)), "corrupt"),  # what some file systems leave
        (lambda data: data + b" " * MAX_BYTES, "corrupt"),
        (lambda _: with_body(b"[" * 100_000), "corrupt"),
        (lambda _: with_body(b"{}"), "corrupt"),
        (lambda _: encoded(StateKey("car-18", KEY.sensor), 9, state(9.0)), "other-vehicle"),
        (lambda _: encoded(StateKey("car-17", "b" * 64), 9, state(9.0)), "other-sensor"),
    ],
)
def test_a_bad_newest_is_set_aside_and_the_one_before_is_used(tmp_path, damage, word):
    store = saved_twice(tmp_path)
    newest = store.path(0)
    bad = damage(newest.read_bytes())
    newest.write_bytes(bad)
    loaded = load(tmp_path)
    assert loaded.content == state(1.0)
    assert len(loaded.problems) == 1
    assert "renamed to" in loaded.problems[0]
    aside = newest.with_name(f"{newest.name}.{word}.1")
    assert aside.read_bytes() == bad
    assert load(tmp_path).problems == ()  # told once
    newest.write_bytes(bad)
    load(tmp_path)
    assert aside.with_name(f"{newest.name}.{word}.2").read_bytes() == bad


@pytest.mark.parametrize(
    "changes",
    [
        {"rotation": (2.0, *IDENTITY[1:])},
        {"rotation": (-1.0, *IDENTITY[1:])},  # a mirror
        {"covariance": (-1e-4, *SMALL[1:])},
        {"covariance": (math.nextafter(4.0, 5.0), *SMALL[1:])},
        {"covariance": (1e-4, 1e-5, *SMALL[2:])},
        {"state": "levelled"},
        {"doubt": "\x1b[2J"},
    ],
)
def test_numbers_that_make_no_sense_are_not_believed_whatever_the_checksum(tmp_path, changes):
    store = StateStore(tmp_path, KEY)
    tmp_path.joinpath(store.path(0)).write_bytes(encoded(KEY, 2, state(2.0, **changes)))
    loaded = load(tmp_path)
    assert loaded.content is None
    assert "is not valid" in loaded.problems[0]


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e999"])
def test_a_number_that_could_not_be_saved_again_is_not_believed(tmp_path, number):
    """With it no later state could be written, and a doubt would not outlast a restart."""
    whole = encoded(KEY, 2, state(2.0, offsets={"gyro_bias": [0.125]}))
    body = whole.partition(b"\n")[2].replace(b"0.125", number.encode())
    StateStore(tmp_path, KEY).path(0).write_bytes(with_body(body))
    loaded = load(tmp_path)
    assert loaded.content is None
    assert "is not valid" in loaded.problems[0]


@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_no_bit_flip_or_cut_is_ever_believed(tmp_path, data):
    store = StateStore(tmp_path, KEY)
    good = encoded(KEY, 1, state(1.0))
    bit = data.draw(st.integers(0, len(good) * 8 - 1))
    cut = data.draw(st.integers(0, len(good)))
    flipped = bytearray(good)
    flipped[bit // 8] ^= 1 << bit % 8
    bad = bytes(flipped[:cut]) if data.draw(st.booleans()) else bytes(flipped)
    store.path(1).write_bytes(bad)
    assert load(tmp_path).content is None


def test_states_of_other_vehicles_stay_where_they_are(tmp_path):
    saved_twice(tmp_path)
    other = StateKey("car-18", KEY.sensor)
    assert load(tmp_path, other) == load(tmp_path / "none", other)
    StateStore(tmp_path, other).save(state(7.0))
    assert load(tmp_path).content == state(2.0)
    assert load(tmp_path, other).content == state(7.0)


@given(st.text(max_size=64), st.text(max_size=64))
def test_file_names_are_plain_and_distinct(one, two):
    names = [StateKey(v, "s").file_name for v in (one, two)]
    assert all("/" not in n and n.isascii() and len(n) < 60 for n in names)
    assert (names[0] == names[1]) == (one == two)


def test_a_full_disk_costs_neither_generation(tmp_path, monkeypatch):
    store = saved_twice(tmp_path)

    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        store.save(state(3.0))
    monkeypatch.undo()
    assert load(tmp_path).content == state(2.0)
    assert len(list(tmp_path.iterdir())) == 2  # nothing half-written is left
    store.save(state(4.0))
    assert load(tmp_path).content == state(4.0)


def test_what_cannot_be_read_is_reported_and_left(tmp_path):
    store = saved_twice(tmp_path)
    store.path(0).unlink()
    store.path(0).mkdir()  # reading it fails, for root too
    loaded = load(tmp_path)
    assert loaded.content == state(1.0)
    assert "cannot be read" in loaded.problems[0]


@pytest.mark.parametrize("slot", [0, 1])
def test_a_folder_in_the_place_of_a_generation_stops_no_later_save(tmp_path, slot):
    store = saved_twice(tmp_path)
    store.path(slot).unlink()
    store.path(slot).mkdir()
    for number in range(3, 7):
        store.save(state(float(number)))
        assert load(tmp_path).content == state(float(number))
    assert load(tmp_path).problems == ()
    assert store.path(slot).with_name(f"{store.path(slot).name}.folder.1").is_dir()


def test_what_is_forgotten_is_set_aside_and_not_loaded_again(tmp_path):
    store = saved_twice(tmp_path)
    store.forget()
    assert load(tmp_path).content is None
    assert len(list(tmp_path.glob("*.forgotten.1"))) == 2


def in_a_child(work) -> int:
    """Exit status of a forked process that did the work."""
    child = os.fork()
    if child == 0:
        status = 99
        try:
            status = work()
        finally:
            os._exit(status)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def test_a_write_that_stops_half_way_costs_neither_generation(tmp_path):
    store = saved_twice(tmp_path)

    def work() -> int:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))
        try:
            store.save(state(3.0))
        except OSError as error:
            return 7 if error.errno == errno.EFBIG else 8
        return 9

    assert in_a_child(work) == 7
    assert load(tmp_path).content == state(2.0)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
def test_a_folder_that_is_read_only_is_read_and_reported():
    with tempfile.TemporaryDirectory() as name:  # pytest's own cannot be reached by others
        folder = Path(name)
        store = saved_twice(folder)
        store.path(0).write_bytes(b"damaged")
        folder.chmod(0o555)

        def work() -> int:
            os.setgid(65534)
            os.setuid(65534)
            loaded = load(folder)
            try:
                store.save(state(3.0))
            except PermissionError:
                good = loaded.content == state(1.0) and "could not be renamed" in loaded.problems[0]
                return 7 if good else 8
            return 9

        assert in_a_child(work) == 7
