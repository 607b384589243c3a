"""Databases with lines that cannot be read, in every encoding, and those that say a thing twice."""

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest

from imucald.can.dbc.database import load_database, load_database_text
from imucald.can.dbc.decode import compile_decode
from imucald.core.errors import DatabaseError

HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: CAR\n'
GOOD = (
    'BO_ 16 GOOD: 8 CAR\n SG_ A : 0|8@1+ (1,0) [0|0] "" CAR\n SG_ B : 8|8@1- (1,0) [0|0] "" CAR\n'
)
LATER = 'BO_ 18 LATER: 1 CAR\n SG_ C : 0|8@1+ (1,0) [0|0] "" CAR\n'


def signal(name: str) -> str:
    return f' SG_ {name} : 0|8@1+ (1,0) [0|0] "" CAR\n'


@pytest.mark.parametrize(
    ("bad", "name", "words"),
    [
        ("BO_ 316495015 M: 8 CAR\n" + signal("S"), "M", "add 2147483648 to it: 2463978663"),
        ("BO_ 4294967295 M: 8 CAR\n" + signal("S"), "M", "more than 29 bits"),
        ("BO_ 17 2017_5: 8 CAR\n" + signal("S"), "2017_5", "is not a valid name"),
        ("BO_ 17 M: CAR\n" + signal("S"), "M", "cannot be read"),
        ("BO 17 M: 8 CAR\n" + signal("S"), "(line 8)", "cannot be read"),
    ],
)
def test_a_message_that_cannot_be_read_costs_itself(bad, name, words):
    database = load_database_text(HEAD + GOOD + bad + LATER, "dbc", "x.dbc")
    plan = compile_decode(database.message("GOOD"), ["A", "B"])
    assert plan.decode(bytes([7, 255, 0, 0, 0, 0, 0, 0])) == (7.0, -1.0)
    assert "S" not in database.message("GOOD").signals
    assert compile_decode(database.message("LATER"), ["C"]).decode(b"\x09") == (9.0,)
    with pytest.raises(DatabaseError, match=r"^x\.dbc:8: message .* left out: .*") as caught:
        database.message(name)
    assert words in str(caught.value)
    assert [words in line for line in database.left_out] == [True]
    with pytest.raises(DatabaseError, match=r"^no message 'OTHER' in x\.dbc( |$)"):
        database.message("OTHER")


def test_all_messages_with_such_an_identifier_are_named_at_once():
    bad = "".join(f"BO_ {5000 + i} M{i}: 8 CAR\n{signal('S')}" for i in range(300))
    database = load_database_text(HEAD + bad + GOOD, "dbc", "x.dbc")
    assert len(database.left_out) == 300
    assert "A" in database.message("GOOD").signals


@pytest.mark.parametrize("line", [signal("0_COUNTER"), " SG_ BAD : 0|8@1+ (1,0) [0|0 CAR\n"])
def test_a_signal_that_cannot_be_read_costs_itself(line):
    database = load_database_text(HEAD + GOOD + line + LATER, "dbc", "x.dbc")
    name = line.split()[1]
    with pytest.raises(DatabaseError, match=rf"^x\.dbc:8: signal GOOD\.{name} is left out"):
        database.signal(f"GOOD.{name}")
    assert set(database.message("GOOD").signals) == {"A", "B"}


@pytest.mark.parametrize(
    "line",
    [
        'VAL_ 16 GONE 0 "off" 1 "on" ;\n',
        'VAL_ 99 A 0 "off" ;\n',
        "SIG_VALTYPE_ 16 GONE : 1;\n",
        'CM_ SG_ 16 "no signal is named";\n',
        'CM_ "no end"\n',
        'BA_DEF_ BO_ "R" BOOL False True;\nBA_ "R" BO_ 16 1;\n',
    ],
)
def test_a_stale_line_costs_nothing(line):
    text = HEAD + GOOD + line + LATER + 'VAL_ 16 A 3 "SNA" ;\n'
    database = load_database_text(text, "dbc", "x.dbc")
    assert database.message("GOOD").signal("A").choices == {3: "SNA"}
    assert set(database.messages) == {"GOOD", "LATER"}


def test_what_makes_another_number_of_a_signal_is_never_left_out():
    with pytest.raises(DatabaseError, match="line 10"):
        load_database_text(HEAD + GOOD + LATER + "SIG_VALTYPE_ 16 : 1;\n", "dbc", "x.dbc")


@pytest.mark.parametrize("multiplexer", ["Mx M : 0|8@1+ (1;0)", "Mx Q : 0|8@1+ (1;0)"])
def test_signals_whose_multiplexer_cannot_be_read_are_not_taken_from_every_frame(multiplexer):
    groups = "".join(
        f' SG_ G{k} m{k} : 8|8@1+ (1,0) [0|0] "" CAR\n SG_ H{k} m{k} : 16|8@1+ (1,0) [0|0] "" CAR\n'
        for k in range(2)
    )
    text = f'BO_ 17 M: 8 CAR\n SG_ {multiplexer} [0|0] "" CAR\n{groups}' + signal("P")
    found = load_database_text(HEAD + text + LATER, "dbc").message("M")
    assert set(found.signals) == {"P"}
    with pytest.raises(DatabaseError, match="multiplexer cannot be read"):
        found.signal("G0")


def test_a_group_that_cannot_be_read_costs_itself_where_its_multiplexer_can():
    text = (
        'BO_ 17 M: 8 CAR\n SG_ Mx M : 0|8@1+ (1,0) [0|0] "" CAR\n'
        ' SG_ G m0 : 8|8@1+ (1;0) [0|0] "" CAR\n SG_ H m1 : 8|8@1+ (1,0) [0|0] "" CAR\n'
    )
    found = load_database_text(HEAD + text, "dbc").message("M")
    assert set(found.signals) == {"Mx", "H"}


def test_a_text_that_never_ends_is_looked_through_once():
    """Each of its quotes could begin another."""
    text = HEAD + "BO_ 17 M-: 8 CAR\n" + GOOD + 'CM_ "' + '\\"' * 20_000
    before = time.process_time()
    assert "GOOD" in load_database_text(text, "dbc").messages
    assert time.process_time() - before < 10.0


def test_two_messages_of_one_name_stay_two_where_a_signal_of_theirs_is_left_out(tmp_path: Path):
    path = tmp_path / "x.dbc"
    bad = ' SG_ Z : 8|8@1+ (1;0) [0|0] "" CAR\n'
    path.write_text(HEAD + GOOD + LATER + "BO_ 18 LATER: 1 CAR\n" + signal("C2") + bad)
    with pytest.raises(DatabaseError, match="two different messages are named LATER"):
        load_database(path).message("LATER")


def test_no_database_is_made_of_any_text():
    with pytest.raises(DatabaseError, match="line 1, column 1"):
        load_database_text("<html>\nnot found\n</html>\n", "dbc", "x.dbc")


def test_damaged_lines_never_change_another_signal():
    """Characters of some lines are deleted: what is still read of the other message is the same."""
    rng = random.Random(5)
    whole = load_database_text(HEAD + GOOD + LATER, "dbc").message("LATER")
    for _ in range(60):
        lines = GOOD.splitlines()
        k = rng.randrange(len(lines))
        at = rng.randrange(1, len(lines[k]))
        lines[k] = lines[k][:at] + lines[k][at + rng.randrange(1, 4) :]
        try:
            found = load_database_text(HEAD + "\n".join(lines) + "\n" + LATER, "dbc")
        except DatabaseError:
            continue
        later = found.messages.get("LATER")  # an open quote may swallow it, or its first line
        assert later is None or later.signals in ({}, whole.signals)
        assert set(found.messages["GOOD"].signals if "GOOD" in found.messages else ()) <= {
            "A",
            "B",
        } | {name for line in lines for name in line.split()}


@pytest.mark.parametrize("suffix", ["dbc", "sym"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_units_are_read_in_every_encoding(tmp_path: Path, suffix: str, encoding: str) -> None:
    text = HEAD + 'BO_ 16 M: 8 CAR\n SG_ S : 0|8@1+ (1,0) [0|0] "m/s²" CAR\n'
    if suffix == "sym":
        text = (
            'FormatVersion=6.0 // x\nTitle="x"\n\n{SENDRECEIVE}\n\n[M]\nID=010h\nLen=8\n'
            "Var=S unsigned 0,8 /u:m/s²\n"
        )
    path = tmp_path / f"bus.{suffix}"
    path.write_bytes(text.encode(encoding))
    assert load_database(path).message("M").signal("S").unit == "m/s²"


def test_one_line_in_another_encoding_leaves_the_others_as_they_are(tmp_path: Path) -> None:
    text = HEAD + 'BO_ 16 M: 8 CAR\n SG_ S : 0|8@1+ (1,0) [0|0] "m/s²" CAR\n'
    path = tmp_path / "bus.dbc"
    path.write_bytes(text.encode() + 'CM_ "Geschwindigkeit über Grund";\n'.encode("cp1252"))
    assert load_database(path).message("M").signal("S").unit == "m/s²"


MULTIPLEXED = (
    "BO_ 16 M: 8 CAR\n"
    ' SG_ MUX M : 0|8@1+ (1,0) [0|0] "" CAR\n'
    ' SG_ S m1 : 8|8@1+ (1,0) [0|0] "" CAR\n'
    ' SG_ S m3 : {} (1,0) [0|0] "" CAR\n'
)


def test_a_signal_in_two_groups_of_a_multiplexer_comes_with_both():
    database = load_database_text(HEAD + MULTIPLEXED.format("8|8@1+"), "dbc", "x.dbc")
    plan = compile_decode(database.message("M"), ["S"])
    found = [plan.decode(bytes([mux, 5, 0, 0, 0, 0, 0, 0]))[0] for mux in range(5)]
    assert found == [None, 5.0, None, 5.0, None]
    assert not database.left_out


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (MULTIPLEXED.format("16|8@1+"), "2 signals named S; the one at bit 16 is used"),
        (GOOD + ' SG_ A : 32|8@1+ (1,0) [0|0] "" CAR\n', "2 signals named A"),
        ('BO_ 16 M: 8 CAR\n SG_ S m0 : 8|8@1+ (1,0) [0|0] "" CAR\n', "has no multiplexer"),
        (
            'BO_ 16 M: 8 CAR\n SG_ P M : 0|8@1+ (1,0) [0|0] "" CAR\n'
            ' SG_ Q M : 8|8@1+ (1,0) [0|0] "" CAR\n SG_ S m0 : 16|8@1+ (1,0) [0|0] "" CAR\n',
            "several and no SG_MUL_VAL_ for this signal",
        ),
    ],
)
def test_a_choice_that_was_made_is_said(text, words):
    database = load_database_text(HEAD + text, "dbc", "x.dbc")
    assert [words in line for line in database.left_out] == [True], database.left_out


KCD = """<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0">
  <Node id="1" name="CAR"/>
  <Bus name="b">
    <!-- <Message id="0xFFFFF" name="NONE"/> -->
    <Message id="0x10" name="GOOD" length="2"><Signal name="A" offset="0" length="8"/></Message>
    {bad}
    <Message id="0xFF9B41" name="LATER" length="1" format="extended">
      <Signal name="C" offset="0" length="8"/></Message>
  </Bus>
</NetworkDefinition>
"""


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ('<Message id="0xFF9B42" name="M" length="9">\n<Signal name="ü" offset="0"/></Message>',
         'not marked as 29 bits; add format="extended" to it'),
        ('<Message id="0xFF9B42" name="M"/>', 'add format="extended"'),
        ('<Message id="0x40000000" name="M" format="extended"/>', "more than 29 bits"),
        ('<Message id="0x11" name="M"><Signal name="S" offset="one"/></Message>', "'one'"),
    ],
)  # fmt: skip
def test_a_message_of_a_kcd_that_cannot_be_read_costs_itself(bad, words):
    database = load_database_text(KCD.format(bad=bad), "kcd", "x.kcd")
    assert compile_decode(database.message("GOOD"), ["A"]).decode(bytes([7, 255])) == (7.0,)
    assert compile_decode(database.message("LATER"), ["C"]).decode(b"\x09") == (9.0,)
    with pytest.raises(DatabaseError, match=r"^x\.kcd:6: message M: left out: .*") as caught:
        database.message("M")
    assert words in str(caught.value)
    assert len(database.left_out) == 1


def test_a_kcd_that_is_no_xml_is_refused():
    with pytest.raises(DatabaseError, match="cannot be read"):
        load_database_text(KCD.format(bad="<Message"), "kcd", "x.kcd")
