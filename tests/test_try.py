"""The bootstrap script `try`: pip from an index, pip's settings, when to install again."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

SCRIPT = Path(__file__).parents[1] / "try"


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Any:
    """The script as a module, with an empty home and a checkout of its own."""
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    loader = SourceFileLoader("try_script", str(SCRIPT))
    spec = importlib.util.spec_from_loader("try_script", loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    (tmp_path / "pyproject.toml").write_text("[project]\n")
    (tmp_path / ".venv").mkdir()
    monkeypatch.setattr(module, "ROOT", tmp_path)
    monkeypatch.setattr(module, "VENV", tmp_path / ".venv")
    monkeypatch.setattr(module, "STAMP", tmp_path / ".venv" / "stamp.json")
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "PIP_CONFIG_FILE", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.delenv("PIP_CERT", raising=False)
    return module


PAGE = """
<a href="../files/pip-9.0.1-py2.py3-none-any.whl">old</a>
<a href="../files/pip-24.0-py3-none-any.whl#sha256=%s" data-requires-python="&gt;=3.7">good</a>
<a href="../files/pip-25.1-py3-none-any.whl" data-yanked="broken">withdrawn</a>
<a href="../files/pip-26.0b1-py3-none-any.whl">not released</a>
<a href="../files/pip-99.0-py3-none-any.whl" data-requires-python="&gt;=3.99">too new</a>
<a href="../files/pip-23.3.2-py3-none-any.whl">older</a>
<a href="../files/pip-99.0.tar.gz">no wheel</a>
"""


def test_the_newest_wheel_that_fits_is_chosen(script: Any) -> None:
    address, digest = script.newest_wheel(PAGE % ("ab" * 32), "https://index.example/simple/pip/")
    assert address == "https://index.example/simple/files/pip-24.0-py3-none-any.whl"
    assert digest == "ab" * 32


def test_a_page_without_pip_is_a_plain_reason_without_the_password(script: Any) -> None:
    with pytest.raises(ValueError, match=r"listed at index\.example/pip/") as caught:
        script.newest_wheel("<html></html>", "https://name:secret@index.example/pip/")
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("honest", [True, False])
def test_a_download_is_checked_against_the_announced_checksum(
    script: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, honest: bool
) -> None:
    content = b"a wheel"
    digest = hashlib.sha256(content if honest else b"another").hexdigest()
    (tmp_path / "pip-24.0-py3-none-any.whl").write_bytes(content)
    pages = {
        "https://index.example/simple/pip/": (PAGE % digest).encode(),
        "https://index.example/simple/files/pip-24.0-py3-none-any.whl": content,
    }
    monkeypatch.setenv("PIP_INDEX_URL", "https://index.example/simple/")
    monkeypatch.setattr(script, "read_address", pages.__getitem__)
    if honest:
        assert script.download_pip(tmp_path).read_bytes() == content
    else:
        with pytest.raises(ValueError, match="another checksum"):
            script.download_pip(tmp_path)


def test_the_second_index_serves_when_the_first_does_not(
    script: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def read(address: str) -> bytes:
        if address.startswith("https://down.example"):
            raise OSError("down")
        return (PAGE % hashlib.sha256(b"w").hexdigest()).encode() if address[-1] == "/" else b"w"

    monkeypatch.setenv("PIP_INDEX_URL", "https://down.example/simple")
    monkeypatch.setenv("PIP_EXTRA_INDEX_URL", "https://up.example/simple")
    monkeypatch.setattr(script, "read_address", read)
    assert script.download_pip(tmp_path).read_bytes() == b"w"
    monkeypatch.delenv("PIP_EXTRA_INDEX_URL")
    monkeypatch.setattr(
        script, "pip_setting", lambda name: "https://down.example" * (name[0] == "i")
    )
    with pytest.raises(OSError, match="down"):
        script.download_pip(tmp_path)


def test_settings_come_from_the_environment_then_from_the_users_file(
    script: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / ".config" / "pip" / "pip.conf"
    file.parent.mkdir(parents=True)
    file.write_text("[global]\nindex-url = https://from.file/simple\n")
    assert script.pip_setting("index-url") == "https://from.file/simple"
    monkeypatch.setenv("PIP_INDEX_URL", "https://from.environment/simple")
    assert script.pip_setting("index-url") == "https://from.environment/simple"
    file.write_text("not a [configuration\n")
    monkeypatch.delenv("PIP_INDEX_URL")
    assert script.pip_setting("no-such-setting") is None


def test_the_installation_stands_until_the_compiled_part_has_other_sources(script: Any) -> None:
    script.STAMP.write_text(script.json.dumps({**script.fingerprint(), "extras": []}))
    kernels = script.ROOT / "daemon" / "imucald" / "core" / "kernels"
    kernels.mkdir(parents=True)
    (kernels / "notes.txt").write_text("no source")
    assert script.is_done("")
    for file in (kernels / "sums.c", kernels / "sums.h", script.ROOT / "setup.py"):
        file.write_text("/* a source */")
        assert not script.is_done("")
        script.STAMP.write_text(script.json.dumps({**script.fingerprint(), "extras": []}))
        assert script.is_done("")


def test_the_installation_stands_until_the_project_file_changes(script: Any) -> None:
    assert not script.is_done("")
    script.STAMP.write_text(script.json.dumps({**script.fingerprint(), "extras": []}))
    assert script.is_done("")
    assert not script.is_done("dev")
    script.STAMP.write_text(script.json.dumps({**script.fingerprint(), "extras": ["dev"]}))
    assert script.is_done("dev")
    assert script.is_done("")
    (script.ROOT / "pyproject.toml").write_text("[project]\n# changed\n")
    assert not script.is_done("dev")
    script.STAMP.write_text("[1, 2")
    assert not script.is_done("")


@pytest.mark.parametrize("fast", [False, True])
def test_the_fast_lane_leaves_out_slow_tests_and_kernels(script: Any, fast: bool) -> None:
    done: list[str] = []
    script.prepare = lambda extra: done.append(f"extra {extra}")
    script.prepare_can_kernel = lambda: done.append("kernel")
    script.os = SimpleNamespace(
        chdir=done.append,
        execv=lambda _, program: done.extend(program),
        environ={"PYTHONDONTWRITEBYTECODE": "1"},
    )
    script.main(["tests", *(["--fast"] if fast else []), "-x"])
    assert script.os.environ == {
        "PYTHONPYCACHEPREFIX": str(script.BYTE_CODE),
        "OPENBLAS_NUM_THREADS": "1",
    }
    assert ("kernel" in done) != fast
    assert ("not slow" in done) == fast
    assert ("tests/vcan" in done) == fast
    assert "--fast" not in done
    assert done[-1] == "-x"


def test_an_old_python_is_shown_what_to_install(
    script: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(script, "OLDEST_PYTHON", (3, 99))
    with pytest.raises(SystemExit, match=r"needs Python 3.99 or newer.*Remedy"):
        script.use_new_enough_python()


@pytest.mark.parametrize("option", ["--help", "-h"])
@pytest.mark.parametrize("command", ["diagnose", "fleet", "replay --report page"])
def test_a_help_installs_nothing_further(script: Any, command: str, option: str) -> None:
    assert "report" in script.extras_of(command.split())
    assert script.extras_of([*command.split(), option]) == []


@pytest.mark.parametrize(
    ("command", "extras"),
    [
        ("replay a.log --write a.csv", ["arrow"]),
        ("replay a.log --write=a.parquet", ["arrow"]),
        ("replay --report page --write a.mf4 a.log", ["report", "mf4"]),
        ("check --config car.yaml drive.mf4", ["mf4"]),
        ("replay a.log.zst b.pcapng", ["logs"]),
        ("fleet --manifest cars.csv", ["fleet", "report"]),
        ("check --config car.yaml speeds.csv", []),
        ("feed mqtt", ["mqtt"]),
        ("monitor --web", ["live"]),
        ("demo", []),
    ],
)
def test_the_extras_that_a_command_needs_are_installed(
    script: Any, command: str, extras: list[str]
) -> None:
    assert script.extras_of(command.split()) == extras


def installs(script: Any, *extras: str) -> list[list[str]]:
    """What pip is called with when these extras are asked for one after the other."""
    calls: list[list[str]] = []
    script.make_venv = lambda: None
    script.runs_quietly = lambda _: True
    script.subprocess = SimpleNamespace(call=lambda command: calls.append(command[4:]) or 0)
    for extra in extras:
        script.prepare(extra)
    return calls


def test_a_further_extra_installs_its_requirements_and_builds_nothing_again(script: Any) -> None:
    (script.ROOT / "pyproject.toml").write_text(
        "[project]\n[project.optional-dependencies]\nreport = ['jinja2>=3.1', 'matplotlib']\n"
    )
    first, second = installs(script, "", "report", "report", "")
    assert first[-2:] == ["--editable", str(script.ROOT)]
    assert second[-2:] == ["jinja2>=3.1", "matplotlib"]
    assert "--editable" not in second
    assert script.is_done("report")


def test_all_is_installed_when_the_extra_comes_first_or_the_project_file_changed(
    script: Any,
) -> None:
    path = script.ROOT / "pyproject.toml"
    path.write_text("[project]\n[project.optional-dependencies]\ndev = ['pytest']\nlive = ['x']\n")
    (first,) = installs(script, "dev")
    assert first[-1] == f"{script.ROOT}[dev]"
    path.write_text(path.read_text() + "# changed\n")
    (again,) = installs(script, "live")
    assert again[-1] == f"{script.ROOT}[live]"


def test_only_for_the_tests_is_all_compiled_at_once(script: Any) -> None:
    (script.ROOT / "pyproject.toml").write_text(
        "[project]\n[project.optional-dependencies]\ndev = ['pytest']\n"
    )
    plain, dev = installs(script, "", "dev")
    assert "--no-compile" in plain
    assert "--no-compile" not in dev
