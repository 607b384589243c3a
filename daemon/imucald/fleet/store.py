"""The folder of a fleet, at any fsspec URL. Each file is written completely or not at all."""

from __future__ import annotations

import os
import uuid
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import fsspec

from imucald.core.errors import ImucaldError
from imucald.core.files import sync_folder
from imucald.fleet.fetch import LOCAL, bare_path, file_system, protocol_of

WORK = "_work"
"""Folder for unfinished files. Readers of tables ignore this folder."""


class Store:
    """The files below one URL. The names of files are paths with slashes."""

    def __init__(self, url: str, storage: Mapping[str, Mapping[str, Any]] | None = None) -> None:
        """Open the file system. Raises ImucaldError if the URL's file system is not available."""
        self.local = protocol_of(url) in LOCAL
        self.url = str(Path(bare_path(url)).absolute()) if self.local else url.rstrip("/")
        self._system: fsspec.AbstractFileSystem = file_system(self.url, storage or {})
        self._root = self._system._strip_protocol(self.url)

    def _place(self, name: str) -> str:
        return f"{self._root}/{name}"

    def write(self, name: str, data: bytes) -> None:
        """Replace a file atomically: at every instant, the complete old file or the complete new
        file exists."""
        try:
            if self.local:
                self._write_local(Path(self._place(name)), data)
            else:
                self._system.pipe_file(self._place(name), data)  # one put: complete or not at all
        except OSError as error:
            text = f"{self.url}/{name}: cannot be written: {error.strerror or error}"
            raise ImucaldError(text) from None

    def _write_local(self, path: Path, data: bytes) -> None:
        making = Path(self._place(WORK)) / f"{path.name}.{uuid.uuid4().hex}"
        making.parent.mkdir(parents=True, exist_ok=True)
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with making.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            making.replace(path)
        except OSError:
            making.unlink(missing_ok=True)
            raise
        sync_folder(path.parent)

    def create(self, name: str, data: bytes) -> bool:
        """Create a file. Return False if the file already exists.

        Creation is exclusive if the storage supports exclusive creation (local, memory, S3). On
        other storage, two callers at the same instant may both get True.
        """
        place = self._place(name)
        if self.local:
            Path(place).parent.mkdir(parents=True, exist_ok=True)
            try:
                with Path(place).open("xb") as file:
                    file.write(data)
            except FileExistsError:
                return False
            return True
        try:
            self._system.pipe_file(place, data, mode="create")
        except FileExistsError:
            return False
        except (NotImplementedError, TypeError, ValueError):
            if self.exists(name):
                return False
            self.write(name, data)
        return True

    def read(self, name: str) -> bytes:
        """Return the content of a file. Raises ImucaldError if the file cannot be read."""
        try:
            self._system.invalidate_cache()
            found: bytes = self._system.cat_file(self._place(name))
        except OSError as error:
            text = f"{self.url}/{name}: cannot be read: {error.strerror or error}"
            raise ImucaldError(text) from None
        return found

    def exists(self, name: str) -> bool:
        """True if a file exists."""
        self._system.invalidate_cache()
        return bool(self._system.exists(self._place(name)))

    def names(self, folder: str, ending: str) -> list[str]:
        """Return the sorted names of the files in a folder; empty if there is no folder."""
        self._system.invalidate_cache()
        try:
            found = self._system.ls(self._place(folder), detail=False)
        except FileNotFoundError:
            return []
        names = (str(path).rpartition("/")[2] for path in found)
        return sorted(f"{folder}/{name}" for name in names if name.endswith(ending))

    def remove(self, name: str) -> None:
        """Delete a file if it exists."""
        with suppress(FileNotFoundError):
            self._system.rm_file(self._place(name))

    def tidy(self) -> None:
        """Delete unfinished files of an earlier run. Only the holder of the lease may call it."""
        if self.local:
            for path in Path(self._place(WORK)).glob("*"):
                path.unlink(missing_ok=True)
