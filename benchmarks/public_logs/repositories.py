"""The public repositories: which commit, which files, under which licence."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Repository:
    """A repository on github.com and the commit whose files are read."""

    owner: str
    name: str
    commit: str
    licence: str

    @property
    def url(self) -> str:
        """Where it is cloned from."""
        return f"https://github.com/{self.owner}/{self.name}"

    @property
    def folder(self) -> str:
        """Name of its clone in the folder of `--data`."""
        return f"{self.owner}+{self.name}"

    def is_in(self, data: Path) -> bool:
        """Whether a clone that holds the commit lies there."""
        folder = data / self.folder
        return folder.exists() and _git(folder, "cat-file", "-e", f"{self.commit}^{{commit}}")[1]

    def file(self, data: Path, path: str) -> bytes:
        """The bytes of a file at the commit. ValueError where the clone lacks it."""
        content, is_there = _git(data / self.folder, "show", f"{self.commit}:{path}")
        if not is_there:
            raise ValueError(f"{self.url}: {path} is not in the clone (a shallow or partial one?)")
        return content

    def files(self, data: Path, folder: str) -> list[str]:
        """Paths of all files below a folder."""
        return _git(data / self.folder, "ls-tree", "-r", "--name-only", self.commit, folder + "/")[
            0
        ].decode().splitlines()  # fmt: skip


def _git(folder: Path, *arguments: str) -> tuple[bytes, bool]:
    done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, check=False)
    return done.stdout, done.returncode == 0


EVERETT = Repository(
    "rtklibexplorer", "GNSS_IMU", "8235ee6c5f349db529bf43ad556a3769b346b5a1", "BSD-3-Clause"
)
VEHSENSE = Repository(
    "wdzhong", "vehsense-backend", "afa964f4ee66cf33af712e033fcf7801a8b9a19d", "MIT"
)
CLOUDPOSE = Repository(
    "cloudpose", "smartphone_driving_dataset", "12ae2e804dcfbbf76b389f8af8ce726f0cb6a2e5",
    "none stated",
)  # fmt: skip
BALZER = Repository(
    "balzer82", "Kalman", "61b1ec4e4a5aaf18e1caa8f3bcd99113daa3d2ca", "CC-BY-SA 2.0"
)
XDRK = Repository(
    "bmc-labs", "xdrk", "825d8afb26a8e9581ee1a79e9f481c69b5c53159", "all rights reserved"
)
DTU = Repository(
    "holgerlindholm", "GNSS_IMU", "4d947e3940589d60325a216014916e9956b4225a", "none stated"
)
SANTOLLAN = Repository(
    "Santollan", "ML-Project---Driving", "699235a784fb089af7efda50135dc8ec292e454d", "none stated"
)
BRODOVSKY = Repository(
    "jbrodovsky", "research", "1d39a1961aac3cc2884477b00ae698d34ee7a37f", "none stated"
)
