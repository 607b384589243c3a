"""Loading databases: broken, hostile and contradicting ones give one clear error."""

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest

from imucald.can.dbc.database import Database, load_database, load_database_text
from imucald.can.dbc.decode import compile_decode
from imucald.can.dbc.encode import compile_encode
from imucald.core.errors import DatabaseError
from paths import ROOT

DATA = ROOT / "tests" / "data"
HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_:\n'
SIGNAL = ' SG_ S : 0|8@1+ (1,0) [0|0] "" Vector__XXX\n'


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatabaseError, match=r"gone\.dbc: No such file"):
        load_database(tmp_path / "gone.dbc")


def test_a_folder_and_a_strange_suffix_are_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.dbc").mkdir()
    with pytest.raises(DatabaseError, match="directory"):
        load_database(tmp_path / "folder.dbc")
    with pytest.raises(DatabaseError, match="not a known database format"):
        load_database(write(tmp_path, "notes.txt", ""))


def test_a_syntax_error_is_given_with_its_line(tmp_path: Path) -> None:
    path = write(tmp_path, "bad.dbc", HEAD + "BO_ 16 M: 8 Vector__XXX\n SG_ S : oops\n")
    with pytest.raises(DatabaseError, match=r"bad\.dbc:6: .*M\.S is left out"):
        load_database(path).signal("M.S")


def test_the_suffix_may_be_in_capitals(tmp_path: Path) -> None:
    path = write(tmp_path, "GOOD.DBC", HEAD + "BO_ 16 M: 8 Vector__XXX\n" + SIGNAL)
    assert list(load_database(path).messages) == ["M"]


def test_overlapping_signals_load(tmp_path: Path) -> None:
    overlapping = SIGNAL + ' SG_ T : 4|8@1+ (1,0) [0|0] "" Vector__XXX\n'
    database = load_database(
        write(tmp_path, "o.dbc", HEAD + "BO_ 16 M: 8 Vector__XXX\n" + overlapping)
    )
    plan = compile_decode(database.message("M"), ["S", "T"])
    assert plan.decode(bytes.fromhex("f300000000000000")) == (243.0, 15.0)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("dbc", HEAD + "BO_ 16 M: 4294967295 Vector__XXX\n" + SIGNAL),
        ("dbc", HEAD + "BO_ 16 M: 8 Vector__XXX\n" + SIGNAL.replace("0|8@", "0|99999999999@")),
        ("dbc", HEAD + "BO_ 16 M: 8 Vector__XXX\n" + SIGNAL.replace("0|8@", "99999999999|8@")),
        ("dbc", HEAD + 'BO_ 16 M: 8 Vector__XXX\n SG_ S m1M : 0|99999999999@1+ (1,0) [0|0] "" X'),
        (
            "dbc",
            HEAD
            + 'BO_ 16 M: 8 Vector__XXX\n SG_ X M : 0|8@1+ (1,0) [0|0] "" Vector__XXX\n'
            + SIGNAL.replace("S :", "S m0 :")
            + "SG_MUL_VAL_ 16 S X 0-4294967295;\n",
        ),
        ("kcd", '<NetworkDefinition><Message id="1" name="M" length="99999999999"/>'),
        ("kcd", '<NetworkDefinition><Signal name="S" offset="99999999999" length="8"/>'),
        ("sym", "FormatVersion=6.0\n[M]\nID=100h\nLen=99999999999\n"),
        ("sym", "FormatVersion=6.0\n{SIGNALS}\nSig=S unsigned 99999999999\n"),
        ("arxml", "<AUTOSAR><LENGTH>99999999999</LENGTH></AUTOSAR>"),
    ],
)
def test_sizes_that_would_take_all_memory_are_refused_at_their_line(kind: str, text: str) -> None:
    with pytest.raises(DatabaseError, match=r"x:\d+: "):
        load_database_text(text, kind, "x")


def test_large_numbers_that_cost_nothing_are_taken() -> None:
    symbols = (DATA / "cluster.sym").read_text()
    symbols += "[PAGES]\nID=201h\nLen=8\nMux=FAR 0,32 99999h\nVar=V unsigned 8,8\n"
    assert "PAGES" in load_database_text(symbols, "sym").messages
    description = (DATA / "cluster.arxml").read_text()
    ethernet = "<I-SIGNAL><SHORT-NAME>CAMERA</SHORT-NAME><LENGTH>524288</LENGTH></I-SIGNAL>"
    at = description.index("<I-SIGNAL>")
    both = description[:at] + ethernet + description[at:]
    assert "IMU" in load_database_text(both, "arxml").messages


def nested(depth: int, values: int) -> str:
    lines = [' SG_ X0 M : 0|4@1+ (1,0) [0|0] "" Vector__XXX']
    ranges = []
    for i in range(1, depth):
        lines.append(f' SG_ X{i} m0M : {4 * i}|4@1+ (1,0) [0|0] "" Vector__XXX')
        ranges.append(f"SG_MUL_VAL_ 16 X{i} X{i - 1} 0-{values - 1};")
    return HEAD + "BO_ 16 M: 8 Vector__XXX\n" + "\n".join(lines) + "\n" + "\n".join(ranges) + "\n"


def test_multiplexers_nested_beyond_reason_are_refused_at_once() -> None:
    start = time.perf_counter()
    with pytest.raises(DatabaseError, match="multiplexers select more than"):
        load_database_text(nested(14, 16), "dbc")
    assert time.perf_counter() - start < 2.0
    assert len(load_database_text(nested(4, 16), "dbc").message("M").signals) == 4


def test_multiplexers_that_select_one_another_are_refused() -> None:
    text = nested(3, 4) + "SG_MUL_VAL_ 16 X0 X2 0-3;\n"
    with pytest.raises(DatabaseError):
        load_database_text(text, "dbc")


def test_xml_that_unfolds_without_end_is_refused() -> None:
    entities = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 20}">' for i in range(1, 12))
    text = f'<?xml version="1.0"?><!DOCTYPE r [<!ENTITY e0 "x">{entities}]><r>&e11;</r>'
    for kind in ("kcd", "arxml"):
        with pytest.raises(DatabaseError):
            load_database_text(text, kind)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dbc", "kcd", "sym", "arxml"])
def test_a_damaged_database_never_crashes(kind: str) -> None:
    """Each damaged text loads or is refused; what loads compiles or is refused."""
    text = (DATA / f"cluster.{kind}").read_text()
    rng = random.Random(11)
    refused = 0
    for _ in range(250 if kind == "dbc" else 120):
        damaged = list(text)
        for _ in range(rng.randint(1, 4)):
            at = rng.randrange(len(damaged))
            action = rng.randrange(4)
            if action == 0:
                damaged[at] = chr(rng.randrange(1, 256))
            elif action == 1:
                del damaged[at : at + rng.randint(1, 30)]
            elif action == 2:
                damaged[at:at] = damaged[at : at + rng.randint(1, 60)]
            else:
                damaged[at] = rng.choice('0123456789-.|@()[];:"<>/ \n')
        try:
            messages = load_database_text("".join(damaged), kind).messages
        except DatabaseError:
            refused += 1
            continue
        for message in messages.values():
            for name in message.signals:
                try:
                    plan = compile_decode(message, [name])
                    plan.decode(bytes(message.length))
                    compile_encode(message, [name])
                except DatabaseError:
                    refused += 1
    assert refused > 20


def test_a_cycle_time_of_a_wrong_kind_is_passed_over() -> None:
    text = HEAD + "BO_ 16 M: 8 Vector__XXX\n" + SIGNAL
    text += 'BA_DEF_ BO_ "GenMsgCycleTime" STRING;\nBA_ "GenMsgCycleTime" BO_ 16 "often";\n'
    assert load_database_text(text, "dbc").message("M").cycle_time is None


def test_two_messages_of_one_name_in_a_file_are_told_apart_by_their_ids(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    text = HEAD + "BO_ 16 M: 8 Vector__XXX\n" + SIGNAL + "\nBO_ 17 M: 8 Vector__XXX\n" + SIGNAL
    text += "\nBO_ 18 N: 8 Vector__XXX\n" + SIGNAL
    database = load_database(write(tmp_path, "a.dbc", text))
    assert {name: m.can_id for name, m in database.messages.items()} == {
        "M_0x10": 16, "M_0x11": 17, "N": 18,
    }  # fmt: skip
    with pytest.raises(DatabaseError, match="two different messages are named M; write M_0x10 or"):
        database.message("M")
    assert not caplog.records


def test_two_messages_of_one_name_and_id_are_refused_when_asked_for(tmp_path: Path) -> None:
    text = HEAD + "BO_ 16 M: 8 Vector__XXX\n" + SIGNAL + "\nBO_ 16 M: 7 Vector__XXX\n" + SIGNAL
    database = load_database(write(tmp_path, "a.dbc", text))
    with pytest.raises(DatabaseError, match=r"two different messages are named M$"):
        database.message("M")


def container() -> Database:
    """A database with a container frame, as an AUTOSAR system description may have."""
    text = HEAD + "BO_ 16 M: 8 Vector__XXX\n" + SIGNAL
    message = load_database_text(text, "dbc").message("M")
    from msgspec.structs import replace

    return Database([replace(message, unsupported="container frames are not supported")], {})


def test_a_container_frame_is_refused_with_its_reason() -> None:
    with pytest.raises(DatabaseError, match="M: container frames are not supported"):
        container().message("M")


def test_an_arxml_that_lacks_an_element_is_refused_with_place_and_remedy() -> None:
    text = (DATA / "cluster.arxml").read_text("utf-8")
    line = text[: text.index("<CAN-FRAME-TRIGGERING>")].count("\n") + 1
    without_id = text.replace("<IDENTIFIER>512</IDENTIFIER>", "")
    with pytest.raises(DatabaseError, match="export the bus as DBC") as refused:
        load_database_text(without_id, "arxml", "car.arxml")
    words = str(refused.value)
    assert f"line {line}, CAN-FRAME-TRIGGERING FT_IMU" in words
    assert "NoneType" not in words


def test_an_arxml_that_describes_no_bus_is_refused_in_plain_words() -> None:
    text = '<AUTOSAR xmlns="http://autosar.org/schema/r4.0"><ADMIN-DATA/></AUTOSAR>'
    with pytest.raises(DatabaseError, match="no packages") as refused:
        load_database_text(text, "arxml", "car.arxml")
    assert "NoneType" not in str(refused.value)
