"""A Dask cluster of separate processes over TLS, and its certificates."""

from __future__ import annotations

import datetime
import json
import random
import subprocess
import sys
import time
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from fleet_files import environment

WORKERS = 2


def tls_files(folder: Path) -> tuple[str, str, str]:
    """Paths of an authority's certificate, a certificate that it signed, and its key (PEM)."""
    authority = ec.generate_private_key(ec.SECP256R1())
    own = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "imucald test")])
    now = datetime.datetime.now(datetime.UTC)

    def signed(public: object, subject: x509.Name, is_authority: bool) -> bytes:
        builder = x509.CertificateBuilder(
            issuer_name=name,
            subject_name=subject,
            public_key=public,  # type: ignore[arg-type]
            serial_number=x509.random_serial_number(),
            not_valid_before=now - datetime.timedelta(hours=1),
            not_valid_after=now + datetime.timedelta(days=1),
        ).add_extension(x509.BasicConstraints(is_authority, None), critical=True)
        found = builder.sign(authority, hashes.SHA256())
        return found.public_bytes(serialization.Encoding.PEM)

    other = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "imucald test node")])
    key = own.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    files = {
        "ca.pem": signed(authority.public_key(), name, True),
        "cert.pem": signed(own.public_key(), other, False),
        "key.pem": key,
    }
    for file, content in files.items():
        (folder / file).write_bytes(content)
    ca, cert, private = (str(folder / file) for file in files)
    return ca, cert, private


class Cluster:
    """A scheduler and its workers; used by `with`."""

    def __init__(self, folder: Path, tls: tuple[str, str, str]) -> None:
        self.tls = tls
        self._folder = folder
        self._file = folder / "scheduler.json"
        self._options = ["--tls-ca-file", tls[0], "--tls-cert", tls[1], "--tls-key", tls[2]]
        self.workers: list[subprocess.Popen[bytes]] = []
        self._scheduler = self._start(
            "scheduler", "--protocol", "tls", "--host", "127.0.0.1", "--port", "0",
            "--scheduler-file", str(self._file), "--no-dashboard",
        )  # fmt: skip

    def _start(self, what: str, *options: str) -> subprocess.Popen[bytes]:
        log = (self._folder / f"{what}-{time.monotonic_ns()}.txt").open("wb")
        command = [sys.executable, "-m", "dask", what, *options, *self._options]
        return subprocess.Popen(command, env=environment(), stdout=log, stderr=log)

    def __enter__(self) -> Cluster:
        until = time.monotonic() + 120.0
        while not (found := self._written()):
            assert self._scheduler.poll() is None, "the scheduler has ended"
            assert time.monotonic() < until
            time.sleep(0.05)
        self.address: str = found["address"]
        for _ in range(WORKERS):
            self._add_worker()
        return self

    def _written(self) -> dict[str, str]:
        """What the scheduler says of itself; nothing where its file is not there, or not whole."""
        try:
            found: dict[str, str] = json.loads(self._file.read_text())
        except (FileNotFoundError, json.JSONDecodeError):
            return {}
        return found

    def _add_worker(self) -> None:
        # without a nanny: what is killed is the worker itself, and the test starts another one
        worker = self._start(
            "worker", self.address, "--no-nanny", "--nthreads", "1", "--no-dashboard",
            "--host", "127.0.0.1", "--local-directory", str(self._folder),
        )  # fmt: skip
        self.workers.append(worker)

    def kill_a_worker(self, chance: random.Random) -> None:
        victim = self.workers.pop(chance.randrange(len(self.workers)))
        victim.kill()
        victim.wait()
        self._add_worker()

    def kill_the_scheduler(self) -> None:
        self._scheduler.kill()
        self._scheduler.wait()

    def __exit__(self, *_: object) -> None:
        for process in (*self.workers, self._scheduler):
            process.kill()
            process.wait()
