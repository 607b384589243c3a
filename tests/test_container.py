"""The container gets all that the package is made of: what its data files point to, too."""

from __future__ import annotations

import re
from pathlib import Path

from paths import ROOT


def copied() -> list[Path]:
    """Files and folders of the checkout that the Containerfile copies in."""
    lines = re.findall(r"^COPY (?!--)(.+) \S+$", (ROOT / "Containerfile").read_text(), re.M)
    return [ROOT / name for line in lines for name in line.split()]


def test_what_is_copied_exists_and_is_not_ignored() -> None:
    allowed = re.findall(r"^!(.+)$", (ROOT / ".containerignore").read_text(), re.M)
    assert (ROOT / "daemon") in copied()
    for path in copied():
        assert path.exists()
        assert path.name in allowed


def test_no_link_of_the_package_points_to_what_is_not_copied() -> None:
    links = [path for path in (ROOT / "daemon").rglob("*") if path.is_symlink()]
    assert len(links) >= 8
    for link in links:
        target = link.resolve()
        assert any(target.is_relative_to(folder) for folder in copied()), link
