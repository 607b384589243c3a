"""`imucald.Config`: a configuration that has been read and checked."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from imucald.config import LoadedConfig
from imucald.config.root import example_path
from imucald.runtime.session import open_config

PathLike = str | os.PathLike[str]


@dataclass(frozen=True, eq=False, repr=False)
class Configuration:
    """A configuration file, read and checked. Create it with `load`. A `Config` can be pickled.

    path: the file. databases: absolute paths of the CAN databases.
    warnings: one line for each key without effect, with its place in the file and the reason.
    """

    path: Path
    databases: tuple[Path, ...]
    warnings: tuple[str, ...]
    loaded: LoadedConfig
    """The settings themselves, for the package's own use."""

    @classmethod
    def load(cls, path: PathLike, databases: Sequence[PathLike] | None = None) -> Configuration:
        """Read a configuration file (YAML).

        databases: database files that replace the databases named in the configuration, in the same
        number and order. Raises ConfigError with one line for each mistake: file, line, key,
        reason, remedy. The content of the databases is checked later, when the configuration is
        used.
        """
        file = Path(path)
        loaded = open_config(file, [Path(database) for database in databases or ()])
        return cls(
            path=file,
            databases=tuple(loaded.database_path(entry) for entry in loaded.config.database),
            warnings=tuple(loaded.idle_keys()),
            loaded=loaded,
        )

    @classmethod
    def example(cls) -> Configuration:
        """Return the configuration of the drives that `imucald simulate` writes."""
        return cls.load(example_path())

    @classmethod
    def of(cls, config: Configuration | PathLike) -> Configuration:
        """Return `config` itself, or load the configuration from a file if `config` is a path."""
        return config if isinstance(config, cls) else cls.load(cast(PathLike, config))

    def __repr__(self) -> str:
        names = ", ".join(path.name for path in self.databases)
        return f"Config({str(self.path)!r}, databases: {names})"
