"""A bundle: a configuration with the content of all files that it names. A bundle is sent to each
worker once per run.

Paths are not valid on another machine. Therefore a bundle contains the bytes of the configuration,
its databases and its model file. The name of a bundle is the hash of these bytes. The same hash
identifies the configuration in the results of a drive.
"""

from __future__ import annotations

import dataclasses
import hashlib
import os
import shutil
import tempfile
import threading
from collections.abc import Mapping
from functools import cache
from multiprocessing.util import Finalize
from pathlib import Path

import msgspec

from imucald import __version__
from imucald.api.configuration import Configuration
from imucald.core.errors import ConfigError
from imucald.core.file_cache import keep_databases
from imucald.runtime.session import make_engine, open_config

KEY_DIGITS = 16
"""Hex digits of a key. With 64 bits, the probability that two of 10^6 logs share a key is 3e-8."""


class Bundle(msgspec.Struct, frozen=True):
    """One configuration: the content of its file, of its databases (in order) and of its model
    file."""

    config: bytes
    config_name: str
    databases: tuple[tuple[str, bytes], ...]
    model: bytes | None = None
    warnings: tuple[str, ...] = ()
    """One line for each key of the configuration that has no effect."""

    @property
    def name(self) -> str:
        """The hash of the content and of imucald's version."""
        content = msgspec.json.encode((__version__, self.config, self.databases, self.model))
        return hashlib.sha256(content).hexdigest()[:KEY_DIGITS]


def bundle_of(config: Path) -> Bundle:
    """Read a configuration and the files that it names. Raises ConfigError if `imucald run` would
    refuse the configuration."""
    loaded = open_config(config)
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
"""Environment variable with the folder of a worker's unpacked bundles, for child processes."""


def unpack(bundles: Mapping[str, Bundle]) -> None:
    """Write bundles to the folder from which the child processes of this process read them."""
    with _Folder.lock:
        if _Folder.path is None:
            _Folder.path = Path(tempfile.mkdtemp(prefix="imucald-fleet-"))
            # atexit would not do: processes of multiprocessing end without it
            Finalize(None, shutil.rmtree, (_Folder.path, True), exitpriority=0)
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
    """Return the configuration of an unpacked bundle. Raises ConfigError if there is no such
    bundle."""
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
    """Return a hash of the source code of this package. A worker with different code may give
    different rows."""
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        digest.update(f"{path.relative_to(package)}\n".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:KEY_DIGITS]
