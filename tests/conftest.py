"""What all tests share: nothing is kept in the user's folders, or from one test to another."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from imucald.core import file_cache as database_cache
from imucald.runtime.consumer import ConsumerGroup


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes minutes in one piece comes first: at the end the other processor would wait."""
    items.sort(key=lambda i: "systemd" not in i.path.parts and "sanitizers" not in i.name)


@pytest.fixture(autouse=True, scope="module")
def drives_of_a_file_are_let_go(request: pytest.FixtureRequest) -> Iterator[None]:
    """A file's cached drives and results are of no use to another file, and take gigabytes."""
    yield
    for value in vars(request.module).values():
        if getattr(value, "__module__", "") == request.module.__name__:
            getattr(value, "cache_clear", lambda: None)()


@pytest.fixture(autouse=True, scope="session")
def own_cache_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    os.environ["CACHE_DIRECTORY"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture(autouse=True)
def databases_are_parsed() -> Iterator[None]:
    yield
    database_cache._Cache.folder = None


@pytest.fixture(autouse=True)
def failed_calculations_fail_the_test(monkeypatch: pytest.MonkeyPatch) -> None:
    """The engine goes on where a consumer's calculation fails; no test may overlook that.

    A module whose subject it is has a fixture of this name that does nothing.
    """

    def failed(self: ConsumerGroup, consumer: object, error: Exception) -> None:
        raise AssertionError(f"a calculation of {consumer} failed") from error

    monkeypatch.setattr(ConsumerGroup, "_failed", failed)
