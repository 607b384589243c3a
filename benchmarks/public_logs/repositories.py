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
KAU = Repository(
    "KauDriverAnalysis", "Driving-Behavior-Analysis-System",
    "427e6dd04b0b817846252feda1b992fce059437d", "none stated",
)  # fmt: skip
COMMA2K19 = Repository("commaai", "comma2k19", "4c7f1a6e1957745beadc1def0e7225f559b09a2a", "MIT")
ESCOOTER = Repository(
    "byu-transpolab", "escooter_pavements", "6fc77bebfef540e3a7ba097ba947570d9958665b",
    "none stated",
)  # fmt: skip
ROAD_SURFACE = Repository(
    "sshaar", "Road-Surface-Feature-Identification", "797c467c329635d2daca0dbe62dd968fe122efdb",
    "none stated",
)  # fmt: skip
INGENIEUR = Repository(
    "FABallemand", "ProjetIngenieur", "c2b348dc39b932fc085f0a2525ad2a67b2aaff65", "none stated"
)
ROBOT_LOCALIZATION = Repository(
    "cra-ros-pkg", "robot_localization", "1cb953379378d13b3e0935ed73d0c7407bd80543",
    "BSD-3-Clause, Apache-2.0",
)  # fmt: skip
ODOMETRY_FUSION = Repository(
    "basavarajnavalgund", "Odometry-IMU-GPS-Fusion", "48e86e285289d5ef13bb1c2b191e9cbba86b65da",
    "none stated; KITTI's is CC-BY-NC-SA 3.0",
)  # fmt: skip
CSS = Repository(
    "CSS-Electronics", "api-examples", "f31d12d8ecdea092a9d56bd915cea88423e1cf5f", "MIT"
)
TORONTO_IMU = Repository(
    "marwanrashed", "INSfullMech", "ab3ff80457aa927a19b4c25c7cb70e0916d4c381", "none stated"
)
TORONTO_OBD = Repository(
    "hanymragab", "plans2025-resources", "5e4745c2bdd0e79ae910c8bd431a26e5e350924b", "MIT"
)
POTHOLES = Repository(
    "jishnu1711", "HiveDrive", "e6dc0347c0a5d9fb78be07793cc1acdfae55acf7", "none stated"
)
REVS = Repository(
    "MBDS", "sideslip-angle-vehicle-estimation", "0446c7659152c4064ea6f520369d3c5b56d222df", "MIT"
)
RACECHRONO = Repository(
    "jLynx", "RaceChrono-to-CSV", "42aab24de857d68e75f28771b292ce52cb4c7ddd", "none stated"
)
NORTHEASTERN = Repository(
    "freecode23", "EECE5554", "835c89825711bad1db89a5e8e0f153dfafdf8ab7", "none stated"
)
PUNE = Repository(
    "AnuragKamblekar", "Interncodes", "c3169c1d55a4438260ab76399c4fc8184a1bd8b6", "none stated"
)
RACECAPTURE = Repository(
    "autosportlabs", "RaceCapture-Pro_firmware", "fa6ecf6d71b88b9b2e751ef7745aaf4d892b53f2",
    "GPL-3.0",
)  # fmt: skip
GENESIS = Repository(
    "MPC-Berkeley", "genesis_path_follower", "7f62ff6d1d16bcfef317181575305811b9460e8a",
    "MIT",
)  # fmt: skip
KITTI_TENSORS = Repository(
    "mkutay", "nn-dead-reckoning", "16d316edfa843ab2923a418085c72c5dd9a1ee96",
    "none stated; KITTI's is CC-BY-NC-SA 3.0",
)  # fmt: skip
AMSTERDAM = Repository(
    "LarsdeWolf", "ML4QS-G28", "13679fcc366306cb5a8963feb67951274b139654", "none stated"
)
ROME = Repository("scikibu", "SL_Road", "e95b9c521d8470932a62cec4735f9c78f12d391b", "none stated")
TRACKADDICT = Repository(
    "thomasjungblut", "trackaddict-cli", "ee1fd37e2ccc00a4d3d733bc36a588694670fcf8", "Apache-2.0"
)
KLANG = Repository(
    "yudhi-chen", "OBD_viewer", "85cf2fb5da5e1201d5af89d0dc5e1d357f4c60f6", "none stated"
)
FREEMATICS = Repository(
    "stanleyhuangyc", "Freematics", "ec62292c017667f41353e1aae5567ced23f74c55", "none stated"
)
BOSTON_1HZ = Repository(
    "ramirez-adr", "EECE5554", "1360753442a372c3c1e62ac0ffde71d47101b162", "none stated"
)
BOSTON_CIRCLES = Repository(
    "sazgar001", "EECE5554", "f8d31a6bf430e277cda6f9121af548cc06cb52d3", "none stated"
)
CSS_PARQUET = Repository(
    "CSS-Electronics", "canedge-mdftoparquet-automation",
    "ed76f8fc85c3559757c725572804e133fbcf6783", "none stated",
)  # fmt: skip
CSS_2026 = Repository(
    "CSS-Electronics", "api-examples", "f7932bacb2969dec591508d15f89e8a898ca99c6", "MIT"
)
FRICTION_MAPS = Repository(
    "AhmadAmine998", "FrictionMaps", "6a1b907d68999067960553bcec18fbf70b30bf4e", "MIT"
)
NAVEGO = Repository("rodralez", "NaveGo", "550d90660dceddf70af8957f1fdc988eb763a315", "LGPL-3.0")
WHEEL_INERTIAL = Repository(
    "ansfl", "WID", "9f15b32a26393c5870e83fc31948280eb41e5710", "none stated"
)
MONTREAL = Repository(
    "Slmaking", "Reorientation-of-smartphone", "2561c55a9dabd6d7b3007b02cb6930447770567a",
    "none stated",
)  # fmt: skip
GYOR = Repository(
    "meszdav", "road-surface-quality", "4512ab613564d725380b8fa8f57f07c1c1aa00b7", "MIT"
)
BOSTON_DRIVE = Repository(
    "aaronpan-eng", "EECE5554", "0d7757a506e1f18ce0b19393b3d290fba0cba6f7", "none stated"
)
BREMEN = Repository(
    "Patricsen-git", "bicycle-database", "3d48e566e5ac6d31cf7105ba25810b033c038c74", "none stated"
)
