"""Mistakes in the diagnostics' configuration: one clear line each; and what its identity covers."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import shuttle
from imucald.config import LoadedConfig, load_config
from imucald.core.errors import ConfigError
from imucald.runtime.session import make_engine
from imucald.service.uds_host import configuration_identity
from imucald.service.uds_on_bus import bus_uds_for


class NoHost:
    """Nobody asks it before it runs."""


def loaded(folder: Path, section: str) -> LoadedConfig:
    config = shuttle.write(folder, cycles=1)
    config.write_text(config.read_text() + section)
    return load_config(config)


def made(folder: Path, section: str):
    config = loaded(folder, section)
    return bus_uds_for(NoHost(), config, make_engine(config))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ("request_id: 0x7B8", "must differ"),
        ("functional_id: 0x7B8", "must differ"),
        ("request_id: 0x18DA55F1", "both have 11 bits, or both 29"),
        ("request_id: 0x20000000", "diagnostics.request_id"),
        ("security: {key_function: no_function}", "key_function"),
        ("security: {key_function: 'a b:c'}", "key_function"),
        ("security: {attempts: 0}", "attempts"),
        ("security: {delay: 0}", "delay"),
        ("port: 13400", "port"),
        ("request_id: 0x640", "0x640 is also an output id"),
        ("response_id: 0x645", "0x645 is also an output id"),
        ("functional_id: 0x200", "0x200 is also an input id"),
        ("security: {key_function: 'no_such_module:key'}", "cannot be imported"),
        ("security: {key_function: 'math:no_such_function'}", "cannot be imported"),
        ("security: {key_function: 'math:pi'}", "is not a function"),
    ],
)
def test_mistakes_are_reported_with_their_place(tmp_path, settings, text):
    with pytest.raises(ConfigError, match=r"shuttle\.yaml:\d+: diagnostics") as error:
        made(tmp_path, f"\ndiagnostics:\n  enabled: true\n  {settings}\n")
    assert text in str(error.value)
    assert len(str(error.value).splitlines()) == 1


def test_a_module_that_fails_when_it_is_imported_is_reported(tmp_path, monkeypatch):
    (tmp_path / "broken_keys.py").write_text("raise RuntimeError('no secret here')")
    monkeypatch.syspath_prepend(tmp_path)
    section = "\ndiagnostics: {enabled: true, security: {key_function: 'broken_keys:key'}}\n"
    with pytest.raises(ConfigError, match="no secret here"):
        made(tmp_path, section)


def test_without_the_package_the_remedy_is_reported(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "isotp", None)
    with pytest.raises(ConfigError, match=r"pip install '\.\[diagnostics\]'"):
        made(tmp_path, "\ndiagnostics: {enabled: true}\n")


def test_identifiers_are_given_to_the_link(tmp_path):
    section = "\ndiagnostics: {enabled: true, request_id: 0x18DA55F1, response_id: 0x18DAF155}\n"
    diagnostics = made(tmp_path, section)
    ids = {0x18DA55F1 | 0x8000_0000, 0x7DF}
    assert diagnostics.ids == ids
    assert {(m.can_id, m.mask) for m in diagnostics.matches} == {
        (0x7DF, 0x7FF),
        (0x18DA55F1 | 0x8000_0000, 0x1FFFFFFF),
    }
    assert diagnostics.own_ids == {0x18DAF155 | 0x8000_0000}
    deaf = made(tmp_path, "\ndiagnostics: {enabled: true, functional_id: null}\n")
    assert deaf.ids == {0x7B0}


def test_the_identity_changes_with_the_settings_and_the_database_only(tmp_path):
    first = configuration_identity(loaded(tmp_path, ""))
    assert len(first) == 32
    same = "\n# a comment\nvehicle: {driving_side: unknown}\n"  # which is the default
    assert configuration_identity(loaded(tmp_path, same)) == first
    assert configuration_identity(loaded(tmp_path, "\nvehicle: {wheelbase: 3.0}\n")) != first
    config = loaded(tmp_path, "")
    (tmp_path / "shuttle.dbc").write_text(shuttle.DBC.replace("0.002", "0.004"))
    assert configuration_identity(config) != first
