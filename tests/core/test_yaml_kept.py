"""A configuration as it was parsed before: never anything else than what parsing would give."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from imucald.config import load_config
from imucald.core import file_cache as database_cache
from imucald.core.errors import ConfigError
from imucald.core.yaml_lines import read_yaml
from imucald.core.yaml_parser import parse_yaml
from paths import ROOT

EXAMPLES = sorted((ROOT / "config" / "examples").glob("*.yaml"))
PROBE = """
import json, sys
from pathlib import Path
import os
from imucald.core.file_cache import keep_databases
keep_databases(os.environ)
from imucald.config import load_config
import imucald.service.service
load_config(Path(sys.argv[1]))
print(json.dumps(sorted({"yaml", "_hashlib"} & set(sys.modules))))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    place = tmp_path / "cache"
    monkeypatch.setattr(database_cache._Cache, "folder", place)
    return place


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.name)
def test_kept_data_and_lines_are_the_parsed_ones(path, folder):
    text = path.read_text()
    parsed = parse_yaml(text, str(path))
    assert read_yaml(text, str(path)) == parsed
    assert len(list(folder.iterdir())) == 1
    assert read_yaml(text, str(path)) == parsed


def test_another_text_is_parsed_and_a_wrong_one_is_reported_each_time(folder):
    assert read_yaml("a: 1", "x")[0] == {"a": 1}
    assert read_yaml("a: 1.0", "x")[0] == {"a": 1.0}
    assert type(read_yaml("a: 1.0", "x")[0]["a"]) is float
    for _ in range(2):
        with pytest.raises(ConfigError, match="x:2: the key 'a' occurs here a second time"):
            read_yaml("a: 1\na: 2", "x")


@pytest.mark.parametrize("text", ["a: .inf", "a: .nan", f"a: {10**30}"])
def test_numbers_that_cannot_be_kept_are_parsed_each_time(text, folder):
    first = read_yaml(text, "x")
    assert repr(read_yaml(text, "x")) == repr(first)


def test_mistakes_have_their_lines_behind_a_kept_configuration(tmp_path, folder):
    path = tmp_path / "a.yaml"
    path.write_text(EXAMPLES[0].read_text() + "\nnonsense: 1\n")
    texts = []
    for _ in range(2):
        with pytest.raises(ConfigError) as error:
            load_config(path)
        texts.append(str(error.value))
    assert texts[0] == texts[1]
    assert "nonsense" in texts[0]


@pytest.mark.slow
def test_a_restart_loads_no_parser_of_yaml_and_no_openssl(tmp_path):
    environment = {**os.environ, "CACHE_DIRECTORY": str(tmp_path / "cache")}
    command = [sys.executable, "-c", PROBE, str(EXAMPLES[0])]
    found = [
        json.loads(
            subprocess.run(
                command, env=environment, capture_output=True, text=True, check=True
            ).stdout
        )
        for _ in range(2)
    ]
    assert found == [["yaml"], []]
