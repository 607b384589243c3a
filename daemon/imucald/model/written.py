"""A model file with only the keys that are written in it. There are no defaults.

A simulated drive needs every parameter and uses defaults for missing keys. In a real vehicle, a
missing number is unknown, so a default must not be used. Each key is therefore read separately. The
schema contains its type, its range and the text of a mistake.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

from imucald.core.errors import ConfigError
from imucald.core.typed import Document, Marks, typed
from imucald.core.yaml_lines import read_yaml_file
from imucald.model.model import WHOLE, VehicleModel
from imucald.model.section import Section, plain


class WrittenModel:
    """The content of a model file, and the mistakes in the keys read so far.

    name: name of the file in texts. unknown: keys that are not in the schema, in the order of the
    file. Unknown keys may be keys of a later version.
    """

    def __init__(self, data: Any, marks: Marks, name: str) -> None:
        self._document = Document(name, marks, WHOLE)
        self._mistakes: dict[str, None] = {}
        data = {} if data is None else plain(data)
        if not isinstance(data, dict):
            raise ConfigError(f"{self._document.located(())}: must be a mapping of sections")
        self._data: dict[str, dict[str, Any]] = {}
        self.unknown: list[str] = []
        for section, content in data.items():
            kind = _types(VehicleModel).get(section)
            if kind is None:
                self.unknown.append(section)
            elif isinstance(kind, type) and issubclass(kind, Section):
                self._take_section(section, content, kind)

    def _take_section(self, section: str, content: Any, kind: type[Section]) -> None:
        if not isinstance(content, dict):
            self.refuse(section, None, "must be a mapping")
            return
        self._data[section] = content
        self.unknown += [f"{section}.{key}" for key in content if key not in _types(kind)]

    @property
    def sections(self) -> list[str]:
        """Sections of the file, in the order of the file."""
        return list(self._data)

    def has(self, section: str, *keys: str) -> bool:
        """True if the file has a section and, if keys are given, at least one of them."""
        found = self._data.get(section)
        return found is not None and (not keys or any(key in found for key in keys))

    def is_set(self, section: str, key: str) -> bool:
        """True if the key has a value that is not zero, not empty and not false. The value is not
        validated."""
        return bool(self._data.get(section, {}).get(key))

    def value(self, section: str, key: str, absent: Any = None) -> Any:
        """Return the value of a key with the type of the schema; `absent` if there is no value.

        A wrong value is recorded as a mistake (see `check`) and counts as absent. A key that is not
        in the schema of the section also counts as absent.
        """
        types = _types(_types(VehicleModel)[section])
        if key not in types or key not in self._data.get(section, {}):
            return absent
        data, place = self._data[section][key], (section, key)
        try:
            return typed(data, types[key], self._document, at=place)
        except ConfigError as error:
            self._mistakes |= dict.fromkeys(str(error).splitlines())
            return absent

    def refuse(self, section: str, key: str | None, reason: str) -> None:
        """Record a mistake that the schema cannot find."""
        place = (section,) if key is None else (section, key)
        self._mistakes[f"{self._document.located(place)}: {reason}"] = None

    def check(self) -> None:
        """Raise ConfigError with one line for each recorded mistake. Without a mistake, do
        nothing."""
        if self._mistakes:
            raise ConfigError("\n".join(self._mistakes))


def read_written(model: Path | Mapping[str, Any], name: str) -> WrittenModel:
    """Read a model file, or a mapping of its content. Raises ConfigError if it is not valid
    YAML."""
    if isinstance(model, Path):
        return WrittenModel(*read_yaml_file(model, WHOLE), name)
    return WrittenModel(model, {}, name)


@cache
def _types(kind: type[Section]) -> dict[str, Any]:
    """Return the type of each key of a section, including the constraints."""
    return get_type_hints(kind, include_extras=True)
