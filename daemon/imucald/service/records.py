"""Saved records: the file format and the method of writing for all data that a daemon stores.

A record is a JSON object in its own files. The first line of a file contains kind, version, length
and SHA-256. A save writes a new file, forces it to the disk, renames it, and forces the folder to
the disk. At every instant, the complete old file or the complete new file exists. With two slots,
two files (``.0`` and ``.1``) alternate, so the previous record remains if the newest record is
damaged. A file is accepted only if length and checksum are right, the version is known, the file
belongs to this daemon's vehicle and sensor, and the content is valid. A file that is not accepted
is renamed and never deleted. The new name contains the reason.

Files are used instead of a database for two reasons. A reset must work at once, even if the disk is
full or a save hangs. Damage to one file must not affect other files. Renaming a file meets both
conditions.

Only one daemon may use a state folder (`folder_lock`).
"""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from msgspec import to_builtins
from msgspec.json import decode

from imucald.core.files import (
    UNFINISHED,
    free_name,
    put_in_place,
    read_regular,
    split_checksum,
    sync_folder,
    with_checksum,
    write_beside,
)
from imucald.service.background_writer import Say, StateWriter
from imucald.service.journal import WARNING

VERSION = 2
READABLE = (b"1", b"2")
"""Versions of the file format that can be read.

Version 1 of a saved state contains sums of evidence that are not used. Version 1 of the other
records contains neither length nor generation.
"""
MAX_BYTES = 1 << 20
"""Largest size of a saved record [bytes]."""
PROBE = "probe"
LARGEST_NUMBER = 2**53
"""Largest accepted number in a file. A float represents every integer up to this number exactly."""
CLOSE_WAIT_S = 0.2
"""Longest wait for the disk for each small record when the daemon stops [s]. The wait for the saved
state is longer."""

Content = TypeVar("Content")


@dataclass(frozen=True)
class Loaded(Generic[Content]):
    """Result of `RecordFiles.load`: the content or None, and one text for each file that was not
    accepted."""

    content: Content | None
    generation: int
    problems: tuple[str, ...]


class _RefusedError(Exception):
    """A file is not accepted. The error contains a word for the file's new name, and a text with
    the reason."""

    def __init__(self, word: str, text: str) -> None:
        super().__init__(text)
        self.word = word


def _damaged(text: str) -> _RefusedError:
    return _RefusedError("corrupt", text)


class RecordFiles(Generic[Content]):
    """Saves and loads one record in its own files.

    kind: first word of each file. read: function that converts a JSON object to the content; it may
    raise any exception if the object is not valid. owner: names and values that must be in the
    file. slots: suffixes of the files that alternate.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        kind: str,
        read: Callable[[Mapping[str, Any]], Content],
        owner: Mapping[str, str] | None = None,
        slots: tuple[str, ...] = ("",),
    ) -> None:
        self.folder = folder
        self.generation = 0
        """Generation of the newest record that was saved, loaded or forgotten."""
        self.is_empty = True
        """True if no record is saved: nothing was saved yet, or everything was forgotten."""
        self.era = 0
        """Counter that increases when all saved records are forgotten. A save with an earlier era
        is ignored.
        """
        self._kind, self._read, self._owner = kind, read, owner or {}
        self._paths = [folder / f"{name}{slot}" for slot in slots]
        self._forgotten: set[Path] = set()
        """Files that were forgotten but may not be renamed yet."""
        self._renaming = threading.Lock()

    def path(self, generation: int) -> Path:
        """Return the path of a generation's file."""
        return self._paths[generation % len(self._paths)]

    def load(self) -> Loaded[Content]:
        """Return the newest acceptable record. Files that are not acceptable are renamed. The call
        never raises an error.
        """
        best: Content | None = None
        generation, highest, problems = 0, 0, []
        for path in self._paths:
            try:
                number, content = self.decoded(read_regular(path, MAX_BYTES))
            except FileNotFoundError:
                continue
            except OSError as error:
                problems.append(
                    f"{path}: cannot be read: {error.strerror}; the file stays where it is"
                )
                continue
            except _RefusedError as reason:
                problems.append(_set_aside(path, reason))
                continue
            highest = max(highest, number)
            if best is None or number > generation:
                best, generation = content, number
        self.generation, self.is_empty = highest, best is None
        return Loaded(best, generation, tuple(problems))

    def save(self, content: Content, era: int | None = None) -> None:
        """Write a new generation of the record.

        Raises OSError if the disk cannot be written; the saved records stay unchanged. era: the era
        in which the content was created. If the records were forgotten after this era, nothing is
        written, and a file that is being written is not renamed to its final name.
        """
        era = self.era if era is None else era
        generation = self.generation + 1
        path = self.path(generation)
        unfinished = write_beside(path, self.encoded(generation, content))
        with self._renaming:
            if era != self.era:
                unfinished.unlink()
                return
            put_in_place(unfinished, path)
            self.generation, self.is_empty = generation, False
            self._forgotten.discard(path)
        self.sync()

    def why_not_writable(self) -> str:
        """Return the reason why no record can be written to the folder now; empty if writing works.
        The call does not wait for the disk.
        """
        probe = self.folder / f"{PROBE}{UNFINISHED}"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            probe.unlink(missing_ok=True)
            with probe.open("xb") as file:
                file.write(bytes(1 << 16))  # most records are smaller
        except OSError as error:
            return error.strerror or str(error)
        finally:
            with contextlib.suppress(OSError):
                probe.unlink()
        return ""

    def forget(self) -> None:
        """Rename the files of all generations, so that no record is loaded any more.

        Raises OSError if a file cannot be renamed; `set_aside_forgotten` then tries again. The call
        never waits for the disk. Without a call of `sync`, which waits, a power cut may undo the
        renames.
        """
        with self._renaming:
            self.era += 1
            self.is_empty = True
            self._forgotten.update(self._paths)
        self.set_aside_forgotten()

    def set_aside_forgotten(self) -> None:
        """Rename forgotten files that are not renamed yet. Raises OSError if a file cannot be
        renamed."""
        failure: OSError | None = None
        with self._renaming:
            for path in sorted(self._forgotten):
                try:
                    if path.exists():
                        path.rename(free_name(path, "forgotten"))
                except OSError as error:
                    failure = error  # the other file may still succeed
                else:
                    self._forgotten.discard(path)
        if failure is not None:
            raise failure

    @property
    def is_forgotten(self) -> bool:
        """True if the next start loads no forgotten record."""
        return not self._forgotten

    def sync(self) -> None:
        """Force the renames of files to the disk. The call waits for the disk."""
        sync_folder(self.folder)

    def encoded(self, generation: int, content: Content) -> bytes:
        """Return the bytes of a file.

        Raises ValueError if a number is not finite, or a text cannot be encoded.
        """
        plain = to_builtins(content, enc_hook=lambda number: number.item())
        record = {**self._owner, "generation": generation, **plain}
        body = json.dumps(record, allow_nan=False, ensure_ascii=False, indent=1).encode()
        return with_checksum(f"{self._kind} {VERSION} {len(body)}", body)

    def decoded(self, data: bytes) -> tuple[int, Content]:
        """Return generation and content of a file's bytes. Raises an error if the file is not
        accepted."""
        title, body, is_right = split_checksum(data)
        kind, _, rest = title.partition(b" ")
        version, _, length = rest.partition(b" ")
        if kind != self._kind.encode() or len(data) > MAX_BYTES:
            raise _damaged("its first line is wrong, or it is too long")
        if version not in READABLE:
            text = version[:12].decode("ascii", "replace")
            raise _RefusedError("other-version", f"its version is {text}, not {VERSION}")
        is_whole = length == str(len(body)).encode() or (version == b"1" and not length)
        if not (is_right and is_whole):
            raise _damaged("its checksum or its length is wrong")
        try:
            record = decode(body)
            generation = record.get("generation", 1)
            owner = {name: str(record[name]) for name in self._owner}
            if type(generation) is not int or not 1 <= generation < LARGEST_NUMBER:
                raise ValueError("generation")
            content = self._read(record)
        except Exception as error:  # whatever a file holds: without it the start goes on
            text = f"its content is not valid ({type(error).__name__}: {error})"
            raise _damaged(text) from None
        for name, value in self._owner.items():
            if owner[name] != value:
                raise _RefusedError(f"other-{name}", f"it belongs to another {name}")
        return generation, content


def _set_aside(path: Path, reason: _RefusedError) -> str:
    """Rename a file that is not accepted. Files that were renamed earlier are kept. Return the text
    for the log."""
    target = free_name(path, reason.word)
    try:
        path.rename(target)
    except OSError as error:
        return f"{path}: {reason}; the file is not used (it could not be renamed: {error.strerror})"
    return f"{path}: {reason}; the file is renamed to {target.name}"


class KeptRecord(Generic[Content]):
    """A record with one slot. The record is read at the start, and a separate thread writes it.

    path: path of the file; with None, nothing is read or saved. kind, read: see `RecordFiles`.
    title: name in the log. say: function that takes a log line and its priority.
    """

    def __init__(
        self,
        path: Path | None,
        kind: str,
        read: Callable[[Mapping[str, Any]], Content],
        title: str,
        say: Say,
    ) -> None:
        self.content: Content | None = None
        """Content of the saved record at the start. None if nothing was saved or the file was not
        accepted."""
        self.problems: tuple[str, ...] = ()
        self.writer: StateWriter[Content] | None = None
        if path is None:
            return
        files = RecordFiles(path.parent, path.name, kind, read)
        loaded = files.load()
        self.content, self.problems = loaded.content, loaded.problems
        for problem in self.problems:
            say(f"{title}: {problem}", WARNING)
        self.writer = StateWriter(files.save, title, say)

    def put(self, content: Content) -> None:
        """Request that `content` is saved soon. The call never waits for the disk."""
        if self.writer is not None:
            self.writer.put(content)
            self.writer.report()

    def close(self) -> None:
        """Write the waiting content. The call waits for the disk for at most `CLOSE_WAIT_S`."""
        if self.writer is not None:
            self.writer.close(CLOSE_WAIT_S)
            self.writer.report()

    def status(self) -> dict[str, Any] | None:
        """Return the number of saves, the number of failures and the last error. None if this
        record is not saved."""
        return None if self.writer is None else self.writer.status()


def clear_unfinished(folder: Path) -> None:
    """Remove files that a power cut left unfinished. The caller must have locked the folder."""
    for path in folder.glob(f"*{UNFINISHED}"):
        with contextlib.suppress(OSError):
            path.unlink()
