"""A configuration with the content of all files it refers to; it is sent to each worker once per
run.

Paths are not valid on another machine. Therefore a bundle holds the bytes of the configuration, its
databases and its model file. The name of a bundle is the hash of these bytes, which also identifies
the configuration that a drive was evaluated with.
"""

from __future__ import annotations

import atexit
import dataclasses
import hashlib
import os
import shutil
import tempfile
import threading
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import msgspec

from imucald import __version__
from imucald.api.configuration import Configuration
from imucald.core.errors import ConfigError
from imucald.core.file_cache import keep_databases
from imucald.runtime.session import make_engine, open_config

KEY_DIGITS = 16
"""Hex digits of a key. With 64 bits, the chance that two of 10^6 logs share a key is 3e-8."""


class Bundle(msgspec.Struct, frozen=True):
    """One configuration: its file, its databases in order, its model file."""

    config: bytes
    config_name: str
    databases: tuple[tuple[str, bytes], ...]
    model: bytes | None = None
    warnings: tuple[str, ...] = ()
    """One line for each key that has no effect."""

    @property
    def name(self) -> str:
        """The hash of the content and of imucald's version."""
        content = msgspec.json.encode((__version__, self.config, self.databases, self.model))
        return hashlib.sha256(content).hexdigest()[:KEY_DIGITS]


def bundle_of(config: Path, databases: Iterable[Path] = ()) -> Bundle:
    """Read a configuration and the files it names. Raises ConfigError if it could not be run."""
    loaded = open_config(config, list(databases))
    make_engine(loaded)
    paths = [loaded.database_path(entry) for entry in loaded.config.database]
    try:
        return Bundle(
            config.read_bytes(),
            config.name,
            tuple((path.name, path.read_bytes()) for path in paths),
            None if loaded.model_path is None else loaded.model_path.read_bytes(),
            tuple(loaded.idle_keys()),
        )
    except OSError as error:
        raise ConfigError(f"{error.filename}: cannot be read: {error.strerror}") from None


class _Folder:
    """The folder in which this process has unpacked its bundles."""

    path: Path | None = None
    lock = threading.Lock()


FOLDER_VARIABLE = "IMUCALD_FLEET_BUNDLES"
"""Environment variable that gives children the folder of their worker's unpacked bundles."""


def unpack(bundles: Mapping[str, Bundle]) -> None:
    """Write bundles to the folder in which the children of this process look for them."""
    with _Folder.lock:
        if _Folder.path is None:
            _Folder.path = Path(tempfile.mkdtemp(prefix="imucald-fleet-"))
            atexit.register(shutil.rmtree, _Folder.path, ignore_errors=True)
            os.environ[FOLDER_VARIABLE] = str(_Folder.path)
    for name, bundle in bundles.items():
        target = _Folder.path / name
        if target.is_dir():
            continue
        making = Path(tempfile.mkdtemp(dir=_Folder.path))
        _write(bundle, making)
        try:
            making.rename(target)
        except OSError:  # another thread was faster
            shutil.rmtree(making, ignore_errors=True)


def _write(bundle: Bundle, folder: Path) -> None:
    (folder / "config.yaml").write_bytes(bundle.config)
    for index, (name, content) in enumerate(bundle.databases):
        place = folder / f"database-{index}"
        place.mkdir()
        (place / name).write_bytes(content)
    if bundle.model is not None:
        (folder / "model.yaml").write_bytes(bundle.model)


def load_bundle(name: str) -> Configuration:
    """The configuration of a bundle that was unpacked. Raises ConfigError if there is none."""
    folder = Path(os.environ.get(FOLDER_VARIABLE, "/nowhere")) / name
    if not folder.is_dir():
        raise ConfigError(f"this worker has no configuration {name}, since it joined another run")
    keep_databases({"CACHE_DIRECTORY": str(folder.parent / "parsed")})  # the first child does it
    databases = sorted(folder.glob("database-*"), key=lambda p: int(p.name.rpartition("-")[2]))
    found = [next(place.iterdir()) for place in databases]
    config = Configuration.load(folder / "config.yaml", found)
    model = folder / "model.yaml"
    if not model.is_file():
        return config
    return dataclasses.replace(config, loaded=config.loaded.with_model(model))


@cache
def code_hash() -> str:
    """Hash of this package's source code: a worker with different code may give different rows."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(f"{path.relative_to(package)}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:KEY_DIGITS]
