"""Text that may name a file whose name is no UTF-8: it can be sent and written all the same."""

from __future__ import annotations

import json
import os

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from imucald.core.errors import ConfigError
from imucald.core.text import encodable, json_text
from imucald.core.yaml_parser import parse_yaml

ANY_TEXT = st.text(st.characters(codec=None, exclude_categories=()))
NAME = os.fsdecode(b"car-\xff.yaml")


@given(ANY_TEXT)
def test_every_text_becomes_encodable_and_one_that_is_stays_as_it_is(text):
    shown = encodable(text)
    shown.encode()
    try:
        text.encode()
    except UnicodeEncodeError:
        assert shown != text
    else:
        assert shown == text


@given(ANY_TEXT)
def test_json_of_every_text_is_read_as_the_text_that_is_shown(text):
    made = json_text({text: [text]}).encode()
    assert json.loads(made) == {encodable(text): [encodable(text)]}


def test_a_byte_that_is_no_utf_8_is_shown_as_the_log_shows_it():
    assert encodable(NAME) == NAME.encode("utf-8", "backslashreplace").decode()
    assert json.loads(json_text(NAME)) == r"car-\udcff.yaml"


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_what_is_no_json_is_refused(number):
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_text([number])


@pytest.mark.parametrize("without_libyaml", [False, True])
def test_a_configuration_cannot_hold_what_utf_8_cannot(without_libyaml, monkeypatch):
    if without_libyaml:
        monkeypatch.delattr(yaml, "CSafeLoader", raising=False)
    with pytest.raises(ConfigError, match=r"car\.yaml:2: "):
        parse_yaml('a: 1\nb: "\\uD800"\n', "car.yaml")
