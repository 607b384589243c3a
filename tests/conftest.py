"""What all tests share: nothing is kept in the user's folders, or from one test to another."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from imucald.core import file_cache as database_cache


@pytest.fixture(autouse=True, scope="session")
def own_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    os.environ["CACHE_DIRECTORY"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(autouse=True)
def databases_are_parsed() -> Iterator[None]:
    yield
    database_cache._Cache.folder = None
