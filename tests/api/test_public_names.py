"""What `import imucald` gives: these names, quickly, and errors that cross processes."""

from __future__ import annotations

import ast
import inspect
import pickle
import subprocess
import sys
from pathlib import Path

import pytest

import imucald
from imucald.core import errors

PUBLIC = [
    "CheckReport",
    "Config",
    "ConfigError",
    "CorrectionResult",
    "DiagnosisResult",
    "DrivePart",
    "DriveResult",
    "DriveSet",
    "DriveStream",
    "Fleet",
    "ImucaldError",
    "LogError",
    "MountResult",
    "WalkResult",
    "__version__",
    "check",
    "diagnose",
    "find_logs",
    "open_result",
    "replay",
    "stream",
    "walk",
]
"""The contract: names are only added."""
IMPORT_S = 0.2
PROBE = """
import time; began = time.perf_counter()
import imucald
took = time.perf_counter() - began
import sys
print(took, *sorted(m for m in sys.modules if m.startswith("imucald") or m in {heavy!r}))
"""
HEAVY = {"numpy", "yaml", "msgspec", "pyarrow", "pandas", "polars", "matplotlib", "asammdf", "mcap"}


def test_the_public_names_are_these():
    assert sorted(imucald.__all__) == PUBLIC
    for name in PUBLIC:
        assert getattr(imucald, name) is not None
        assert name in dir(imucald)
    with pytest.raises(AttributeError, match="nothing_such"):
        _ = imucald.nothing_such


def test_no_public_name_is_hidden_by_a_module_of_the_same_name():
    package = Path(imucald.__file__).parent
    modules = {path.stem for path in package.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert not modules & set(PUBLIC)


def test_type_checkers_and_the_interpreter_see_the_same():
    tree = ast.parse(inspect.getsource(imucald))
    (block,) = [n for n in tree.body if isinstance(n, ast.If)]
    typed = {
        alias.asname or alias.name: (node.module.removeprefix("imucald."), alias.name)
        for node in block.body
        for alias in node.names
    }
    assert typed == imucald._PLACES
    assert {*typed, "__version__"} == set(PUBLIC)


def test_everything_public_says_what_it_is():
    for name in PUBLIC:
        found = getattr(imucald, name)
        if callable(found):
            assert inspect.getdoc(found), name
            for inner, method in vars(found).items() if inspect.isclass(found) else ():
                if not inner.startswith("_") and (callable(method) or isinstance(method, property)):
                    assert inspect.getdoc(method), f"{name}.{inner}"


def test_an_import_is_quick_and_loads_nothing():
    code = PROBE.replace("{heavy!r}", repr(HEAVY))
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        for _ in range(3)
    ]
    words = [run.stdout.split() for run in runs]
    assert words[0][1:] == ["imucald"]
    assert min(float(w[0]) for w in words) < IMPORT_S


def every_error():
    return [c for c in vars(errors).values() if inspect.isclass(c) and issubclass(c, Exception)]


@pytest.mark.parametrize("kind", every_error())
def test_errors_cross_processes_as_they_are(kind):
    error = kind("short_frame", "too short") if kind is errors.DecodeError else kind("a.log:3: bad")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert str(again) == str(error)
    assert vars(again) == vars(error)
    assert isinstance(again, imucald.ImucaldError)
