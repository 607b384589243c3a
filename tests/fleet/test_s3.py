"""Logs and tables in an S3 store, where s3fs and moto are installed (they are no dependencies)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fleet_files import CONFIG, make_fleet, tables_of, whole_log

from imucald.cli import main
from imucald.core.errors import ImucaldError
from imucald.fleet.lease import Lease
from imucald.fleet.store import Store

pytestmark = pytest.mark.slow


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A server that speaks S3; secrets come from the environment."""
    pytest.importorskip("s3fs")
    server = pytest.importorskip("moto.server").ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "test")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "test")
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


def test_a_fleet_in_s3_has_the_tables_of_one_on_disk(tmp_path: Path, endpoint: str) -> None:
    import fsspec

    path = make_fleet(tmp_path, whole_log(tmp_path / "whole.log"), 4)
    options = f"storage: {{s3: {{endpoint_url: '{endpoint}'}}}}\n"
    s3 = fsspec.filesystem("s3", endpoint_url=endpoint)
    s3.mkdir("lake")
    s3.put(str(tmp_path / "logs"), "lake/raw/logs", recursive=True)
    path.write_text(f"logs: 's3://lake/raw/logs/*/*.log'\nconfig: {CONFIG}\n{options}")
    command = ["fleet", "run", "--fleet", str(path), "--quiet", "--signals", "corrected"]
    assert main([*command, "--out", str(tmp_path / "disk")]) == 0
    assert main([*command, "--out", "s3://lake/fleet"]) == 0
    store = Store("s3://lake/fleet", {"s3": {"endpoint_url": endpoint}})
    for name, data in tables_of(tmp_path / "disk").items():
        assert store.read(name) == data
    assert len(s3.glob("lake/fleet/signals/accel/*/*/*.parquet")) == 4
    assert sorted(store.names("drives", "")) == ["drives/drives.parquet"]
    assert main(["fleet", "analyse", "--out", "s3://lake/fleet", "--fleet", str(path)]) == 0
    assert store.exists("analysis/vehicles/vehicles.parquet")
    with Lease(store), pytest.raises(ImucaldError, match="another run"), Lease(store):
        pass
