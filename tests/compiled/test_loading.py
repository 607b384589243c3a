"""The library is used where it is sound, and left alone without a word where it is not."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from sysconfig import get_path

import pytest
from recorded_calls import CONFIG, needs_kernels, simulated

import imucald
from imucald.core import compiled
from imucald.core.compiled import NAME, SOURCES, SWITCH, load
from paths import ROOT

FOLDER = SOURCES.parent
SUFFIX = EXTENSION_SUFFIXES[0]
NO_SOURCES = Path("/nothing/here")
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler")
needs_headers = pytest.mark.skipif(
    shutil.which("cc") is None or not Path(get_path("include"), "Python.h").exists(),
    reason="there is no C compiler, or no header of Python",
)


def library() -> Path:
    """The one that is in use."""
    return next(path for path in FOLDER.glob(f"{NAME}.*") if path.name[len(NAME) :] == SUFFIX)


@pytest.fixture
def beside(tmp_path: Path) -> Path:
    """A folder with the library and its sources."""
    if compiled.kernels is None:
        pytest.skip(f"kernels: {compiled.state}")
    shutil.copytree(SOURCES, tmp_path / "kernels")
    shutil.copy(library(), tmp_path)
    return tmp_path


@needs_headers
def test_where_it_can_be_built_the_tests_use_the_library() -> None:
    if os.environ.get(SWITCH) == "0":
        pytest.skip("it is left out here")
    assert compiled.state == "in use"


def test_a_library_with_its_sources_is_used(beside: Path) -> None:
    kernels, state = load(beside, beside / "kernels")
    assert kernels is not None
    assert state == "in use"


def test_a_library_of_an_installed_package_has_no_sources(beside: Path) -> None:
    assert load(beside, NO_SOURCES)[1] == "in use"


def test_without_a_library_there_is_none(tmp_path: Path) -> None:
    assert load(tmp_path) == (None, "not built")


def test_a_library_of_other_sources_is_left_alone(beside: Path) -> None:
    (beside / "kernels" / "more.c").write_text("/* new */")
    assert load(beside, beside / "kernels") == (None, "built from other sources")


def test_other_files_beside_the_sources_are_none(beside: Path) -> None:
    (beside / "kernels" / "notes.txt").write_text("new")
    assert load(beside, beside / "kernels")[1] == "in use"


@pytest.mark.parametrize("content", [b"", b"no library", b"\x7fELF" + bytes(100)])
def test_a_broken_library_is_left_alone(tmp_path: Path, content: bytes) -> None:
    (tmp_path / (NAME + SUFFIX)).write_bytes(content)
    kernels, state = load(tmp_path)
    assert kernels is None
    assert state.startswith("cannot be loaded: ")


@needs_compiler
@pytest.mark.parametrize(
    ("text", "state"),
    [
        ("int stamp(void) { return 0; }", "cannot be loaded: "),
        ("int nothing;", "cannot be loaded: "),
    ],
)
def test_a_library_without_the_kernels_is_left_alone(tmp_path: Path, text: str, state: str) -> None:
    (tmp_path / "other.c").write_text(text)
    target = tmp_path / (NAME + SUFFIX)
    made = ["cc", "-shared", "-fPIC", str(tmp_path / "other.c"), "-o", str(target)]
    subprocess.run(made, check=True)
    found, said = load(tmp_path, NO_SOURCES)
    assert found is None
    assert said.startswith(state)


def test_the_switch_leaves_it_out(beside: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SWITCH, "0")
    assert load(beside) == (None, f"switched off by {SWITCH}=0")
    monkeypatch.setenv(SWITCH, "1")
    assert load(beside, beside / "kernels")[1] == "in use"


def test_a_replay_without_it_gives_the_same(tmp_path: Path) -> None:
    log = simulated(tmp_path, 1.0)
    code = (
        "import imucald; from imucald.core import compiled; "
        f"d = imucald.replay(imucald.Config.load({str(CONFIG)!r}), {str(log)!r}); "
        "print(compiled.state); print(d.to_dict())"
    )
    command, without = [sys.executable, "-c", code], os.environ | {SWITCH: "0"}
    done = subprocess.run(command, env=without, check=True, capture_output=True, text=True)
    state, result = done.stdout.splitlines()
    assert state == f"switched off by {SWITCH}=0"
    assert result == str(imucald.replay(imucald.Config.load(CONFIG), log).to_dict())


def test_program_and_pages_say_the_same_of_the_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    """4 times for a log of our own signals, 10 among those of other units: no single number."""
    monkeypatch.setattr(compiled, "kernels", None)
    texts = [compiled.slow_words()]
    for page, word in (("README.md", "C compiler"), ("docs/python.md", "C compiler")):
        (line,) = (x for x in (ROOT / page).read_text().splitlines() if word in x)
        texts.append(line)
    for text in texts:
        assert "several times as" in text
        assert not re.search(r"\d times as|a sixth", text)


@pytest.mark.parametrize("command", ["replay", "run"])
def test_that_it_is_slow_without_it_is_said_once(tmp_path: Path, command: str) -> None:
    more = ["--interface", "virtual", "--channel", "slow", "--seconds", "0.2"]
    if command == "replay":
        more = [str(simulated(tmp_path, 0.2))] * 2
    arguments = [sys.executable, "-m", "imucald", command, "--config", str(CONFIG), *more]
    for switch, times in (("0", 1), ("1", int(compiled.kernels is None))):
        variables = os.environ | {SWITCH: switch, "XDG_RUNTIME_DIR": str(tmp_path)}
        done = subprocess.run(arguments, env=variables, check=True, capture_output=True, text=True)
        assert (done.stdout + done.stderr).count("slow: the compiled part is missing") == times


@needs_kernels
def test_it_is_loaded_within_five_milliseconds(beside: Path) -> None:
    took = []
    for _ in range(20):
        began = time.process_time()
        load(FOLDER)
        took.append(time.process_time() - began)
    assert min(took) < 0.005


def test_the_version_says_whether_it_is_used() -> None:
    command = [sys.executable, "-m", "imucald", "--version"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    said = f"imucald {imucald.__version__} (compiled part: {compiled.state})"
    assert done.stdout.strip() == said


def checkout(target: Path) -> Path:
    """What a build of the compiled part looks at."""
    shutil.copy(ROOT / "setup.py", target)
    kernels = target / "daemon" / "imucald" / "core" / "kernels"
    shutil.copytree(SOURCES, kernels)
    (kernels.parent / "__init__.py").touch()
    (kernels.parents[1] / "__init__.py").touch()
    return target


def built(folder: Path, **variables: str) -> tuple[str, list[Path]]:
    """Output of a build, and the libraries that it made."""
    command = [sys.executable, "setup.py", "-q", "build_ext", "--build-lib", "made"]
    done = subprocess.run(
        command, cwd=folder, env=os.environ | variables, check=True, capture_output=True, text=True
    )
    return done.stdout + done.stderr, list((folder / "made").rglob(f"{NAME}*"))


@pytest.mark.slow
@needs_headers
def test_a_build_makes_a_library_that_is_used(tmp_path: Path) -> None:
    pytest.importorskip("setuptools")
    _, (made,) = built(checkout(tmp_path))
    assert load(made.parent, SOURCES)[1] == "in use"


def test_a_build_without_a_compiler_succeeds(tmp_path: Path) -> None:
    pytest.importorskip("setuptools")
    said, made = built(checkout(tmp_path), CC="/nothing/here/cc")
    assert not made
    assert "failed" in said


def test_a_build_may_leave_it_out(tmp_path: Path) -> None:
    pytest.importorskip("setuptools")
    assert not built(checkout(tmp_path), **{SWITCH: "0"})[1]


@pytest.mark.slow
@needs_headers
def test_a_build_leaves_no_library_of_an_earlier_one(tmp_path: Path) -> None:
    pytest.importorskip("setuptools")
    (library,) = built(checkout(tmp_path))[1]
    source = tmp_path / "daemon" / "imucald" / "core" / "kernels" / "stamp.c"
    source.write_text(source.read_text() + "/* another release */\n")
    os.utime(source, (0, 0))  # as an archive may have it
    built(tmp_path)
    elsewhere = tmp_path / "elsewhere"  # a process loads a name once
    elsewhere.mkdir()
    shutil.copy(library, elsewhere)
    assert load(elsewhere, source.parent)[1] == "in use"
    assert not built(tmp_path, CC="/nothing/here/cc")[1]


@pytest.mark.slow
@needs_headers
@pytest.mark.parametrize("flag", ["-Ofast", "-ffast-math"])
def test_no_flag_makes_a_library_that_flushes_small_numbers(tmp_path: Path, flag: str) -> None:
    pytest.importorskip("setuptools")
    _, (made,) = built(checkout(tmp_path), CFLAGS=flag)
    code = f"import ctypes, sys; ctypes.PyDLL({str(made)!r}); print(sys.float_info.min / 2.0 > 0.0)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout.strip() == "True"
    assert load(made.parent, SOURCES)[1] == "in use"
