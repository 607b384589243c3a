"""Man page and completion: made from the parser, so they know every command and option."""

from __future__ import annotations

import argparse
import importlib.util
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import pytest

from imucald import cli
from paths import ROOT

BASH = """
source {file}
COMP_WORDS=(imucald {words})
COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
$(complete -p imucald | sed -E 's/.*-F ([^ ]+).*/\\1/')
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def help_files() -> ModuleType:
    spec = importlib.util.spec_from_file_location("help_files", ROOT / "deb/help_files.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def written(help_files: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("usr")
    for path in help_files.write(folder):
        assert path.stat().st_size > 500
    return folder


def test_the_page_has_every_command_and_option(help_files: ModuleType) -> None:
    page = help_files.man_page().replace("\\-", "-")
    (commands,) = cli.build_parser()._subparsers._group_actions  # type: ignore[union-attr]
    assert isinstance(commands, argparse._SubParsersAction)
    for name, parser in commands.choices.items():
        section = page.partition(f"'imucald {name}'")[2]
        assert section, name
        for action in parser._actions:
            for option in action.option_strings:
                assert option in ("-h", "--help") or option in section, f"{name} {option}"


@pytest.mark.skipif(shutil.which("mandoc") is None, reason="mandoc is not installed")
def test_the_page_is_sound_for_an_independent_reader(written: Path) -> None:
    page = written / "share/man/man1/imucald.1.gz"
    done = subprocess.run(
        ["mandoc", "-T", "lint", "-W", "error", str(page)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (0, "")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("rep", {"replay"}),
        ("replay --js", {"--json"}),
        ("fleet ana", {"analyse"}),
        ("replay --config pypro", {"pyproject.toml"}),
        ("init --driving-side l", {"left"}),
    ],
)
def test_bash_completes_commands_options_and_files(
    words: str, expected: set[str], written: Path
) -> None:
    file = written / "share/bash-completion/completions/imucald"
    done = subprocess.run(
        ["bash", "-c", BASH.format(file=file, words=words)],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    assert set(done.stdout.split()) == expected
