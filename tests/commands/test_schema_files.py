"""Editors find the schema of every YAML file that a command writes, in a draft that they read."""

from __future__ import annotations

import json
import re
from pathlib import Path

import jsonschema
import pytest
import yaml

from imucald.can.logs.log_reader import CandumpWriter
from imucald.cli import main
from imucald.commands.schema import CONFIGURATION, MODEL, schema_text
from paths import ROOT
from simulated_bus import drive_frames

CONFIGURATIONS = [ROOT / "config/imucald.yaml", *sorted(ROOT.glob("config/examples/*.yaml"))]
MODELS = sorted((ROOT / "config/examples/models").glob("*.yaml"))
LATER = {"$defs", "prefixItems", "dependentRequired", "dependentSchemas", "unevaluatedProperties"}
"""Keywords that draft 7 does not have, and that its readers pass over."""


def schema_of(written: Path) -> jsonschema.Draft7Validator:
    """As an editor finds it: by the file's first line."""
    first, _, _ = written.read_text().partition("\n")
    line = re.fullmatch(r"# yaml-language-server: \$schema=(\S+)", first)
    assert line is not None
    content = json.loads((written.parent / line[1]).read_text())
    assert content["$schema"] == "http://json-schema.org/draft-07/schema#"
    jsonschema.Draft7Validator.check_schema(content)
    assert not LATER & set(keys(content))
    return jsonschema.Draft7Validator(content)


def keys(node: object) -> list[str]:
    if isinstance(node, dict):
        return [*node, *(key for value in node.values() for key in keys(value))]
    return [key for one in node for key in keys(one)] if isinstance(node, list) else []


@pytest.mark.slow
def test_the_configuration_of_init_names_a_schema_that_it_keeps_to(tmp_path):
    log, out = tmp_path / "drive.log", tmp_path / "car.yaml"
    with CandumpWriter(log) as writer:
        writer.write_columns(drive_frames())
    database = str(ROOT / "dbc" / "imucald_example.dbc")
    assert main(["init", "--database", database, str(log), "--out", str(out)]) == 0
    schema, content = schema_of(out), yaml.safe_load(out.read_text())
    assert not list(schema.iter_errors(content))
    assert not schema.is_valid({**content, "vehicel": {}})
    content["vehicle"]["track"] = "wide"
    assert not schema.is_valid(content)


@pytest.mark.parametrize("example", CONFIGURATIONS, ids=lambda path: path.stem)
def test_an_example_names_the_schema_of_today_and_keeps_to_it(example: Path):
    assert not list(schema_of(example).iter_errors(yaml.safe_load(example.read_text())))
    kept = ROOT / "config" / CONFIGURATION
    assert kept.read_text() == schema_text(CONFIGURATION), (
        f"imucald schema > config/{CONFIGURATION}"
    )


@pytest.mark.parametrize("name", [CONFIGURATION, MODEL])
def test_limits_are_written_alike_whatever_module_was_imported_first(name: str):
    """Equal limits of two modules, 5 and 5.0, are one object to `typing`."""
    limits = re.findall(r'"(?:m|exclusiveM)(?:ax|in)imum": (.+?),?$', schema_text(name), re.M)
    assert len(limits) > 50
    assert not [limit for limit in limits if limit.endswith(".0")]


def test_a_model_file_names_a_schema_that_it_keeps_to(tmp_path):
    out = tmp_path / "model.yaml"
    log = str(tmp_path / "drive.log")
    assert main(["simulate", "--minutes", "0.05", "--out", log, "--write-model", str(out)]) == 0
    schema = schema_of(out)
    for model in (out, *MODELS):
        assert not list(schema.iter_errors(yaml.safe_load(model.read_text()))), model
    assert not schema.is_valid({"accel": {"bias": [0.0, 0.0]}})
    assert not schema.is_valid({"acel": {}})


def test_standard_output_names_no_file(capsys):
    database = str(ROOT / "dbc" / "imucald_example.dbc")
    assert main(["init", "--database", database]) == 0
    assert "yaml-language-server" not in capsys.readouterr().out
