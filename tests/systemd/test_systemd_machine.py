"""The machine under the service's tests: systemd boots, CAN is there, a notifying unit starts."""

from __future__ import annotations

from typing import Any

import pytest

pytestmark = pytest.mark.slow

UNIT = """[Unit]
BindsTo=sys-subsystem-net-devices-vcan0.device
After=sys-subsystem-net-devices-vcan0.device
[Service]
Type=notify
DynamicUser=yes
RestrictAddressFamilies=AF_CAN AF_UNIX
ExecStart=/usr/bin/python3 /opt/notifier.py
"""

NOTIFIER = """
import os, socket, time
with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
    bus.bind(("vcan0",))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as notify:
        notify.sendto(b"READY=1\\nSTATUS=hears vcan0", os.environ["NOTIFY_SOCKET"])
    time.sleep(60)
"""

SCRIPT = """
systemctl --version | head -n 1
ps -p 1 -o comm= 2>/dev/null || cat /proc/1/comm
modprobe vcan && ip link add dev vcan0 type vcan && ip link set up dev vcan0 || exit 3
systemctl start notifier.service || { systemctl status notifier.service; exit 4; }
systemctl show notifier.service --property=ActiveState,StatusText
ls /src-of-the-tests
exit 7
"""


def test_a_notifying_unit_reaches_active_on_a_vcan_device(
    run_under_systemd: Any, tmp_path: Any
) -> None:
    files = {"/etc/systemd/system/notifier.service": UNIT, "/opt/notifier.py": NOTIFIER}
    script = SCRIPT.replace("/src-of-the-tests", str(tmp_path))
    outcome = run_under_systemd(script, files=files, shared=[tmp_path])
    assert outcome.status == 7, outcome.console + outcome.output
    assert outcome.output.splitlines()[1] == "systemd"
    assert "ActiveState=active" in outcome.output
    assert "StatusText=hears vcan0" in outcome.output
    assert "exchange" in outcome.output  # the shared folder is seen
