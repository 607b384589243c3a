"""Runs inside the machine: faults on a real systemd and vcan, what came of each as one JSON line.

Plain Python of the machine, nothing else: it is copied there as it stands.
"""

import contextlib
import json
import os
import pathlib
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import urllib.request

UNIT = "imucald@vcan0.service"
FRAME = struct.Struct("=IB3x8s")
LEVEL = bytes.fromhex("0000000027130000")  # an accelerometer frame: 1 g up
CORRECTED = 0x640
STATE = pathlib.Path("/var/lib/imucald/vcan0")
KILLS = 10
DELETIONS = 10
STARTS = pathlib.Path("/var/cache/imucald/vcan0/starts")
MINUTE_S = 60.0
BARE = (
    *("systemd-run", "--wait", "--quiet", "--setenv=PYTHONPATH=/usr/lib/imucald"),
    *("/usr/bin/python3", "-c", "import can, cantools, numpy"),
)
URL = "http://127.0.0.1:8131/metrics"
CACHE = pathlib.Path("/var/cache/imucald/vcan0")


def shell(*command, check=True):
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if check and done.returncode:
        raise RuntimeError(f"{command}: {done.stdout}{done.stderr}")
    return done.stdout


def show(name):
    return shell("systemctl", "show", UNIT, f"--property={name}", "--value").strip()


def journal(lines):
    """The last lines of the unit's log, those included that are still on their way to the disk."""
    shell("journalctl", "--sync")
    return shell("journalctl", "-u", UNIT, "-n", str(lines))


def status():
    return json.loads(shell("imucald", "status", "vcan0", "--json", check=False))


def wait(condition, limit=30.0):
    """Seconds until the condition holds."""
    began = time.monotonic()
    while not condition():
        if time.monotonic() - began > limit:
            print(shell("systemctl", "status", UNIT, check=False))
            print(shell("journalctl", "-u", UNIT, "-n", "40", check=False))
            raise TimeoutError(condition)
        time.sleep(0.02)
    return time.monotonic() - began


class Sensor:
    """A node that sends accelerometer frames without end, and hears the corrected ones.

    quality, heard: of the last corrected frame, and when. worst_gap: longest silence [s].
    """

    def __init__(self):
        self.quality, self.heard, self.values = -1, 0.0, None
        self.on = True
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self):
        while self.on:
            try:
                with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
                    option = struct.pack("=II", CORRECTED, 0x7FF)
                    bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, option)
                    bus.bind(("vcan0",))
                    bus.setblocking(False)
                    self.exchange(bus)
            except OSError:
                time.sleep(0.01)

    def exchange(self, bus):
        socket.if_nametoindex("vcan0")
        checked = time.monotonic()
        while self.on:
            bus.send(FRAME.pack(0x200, 8, LEVEL))
            time.sleep(0.01)
            with contextlib.suppress(BlockingIOError):
                while True:  # the newest counts
                    _, _, data = FRAME.unpack(bus.recv(16))
                    self.quality, self.heard = data[6] & 0xF, time.monotonic()
                    self.values = struct.unpack("<3h", data[:6])
            if time.monotonic() - checked > 0.2:
                checked = time.monotonic()
                if socket.if_nametoindex("vcan0") != self.index(bus):
                    raise OSError("another interface")

    @staticmethod
    def index(bus):
        return socket.if_nametoindex(bus.getsockname()[0])

    def good_since(self, t):
        return self.heard > t and self.quality >= 1

    def stop(self):
        self.on = False
        self.thread.join()


def begin():
    pathlib.Path("/usr/bin/imucald").chmod(0o755)
    shell("imucald", "install-service", "--prefix", "/usr", "--exec", "/usr/bin/imucald")
    shell("modprobe", "vcan")
    make_interface()
    shell("systemctl", "daemon-reload")
    shell("systemctl", "enable", "--now", UNIT)
    exposure = shell("systemd-analyze", "security", UNIT).splitlines()[-1]
    return {
        "active": show("ActiveState"),
        "status": show("StatusText"),
        "exposure": exposure,
        "user": shell("stat", "-c", "%U", f"/proc/{show('MainPID')}").strip(),
        "mode": oct(STATE.stat().st_mode & 0o777),
    }


def make_interface():
    shell("ip", "link", "add", "dev", "vcan0", "type", "vcan")
    shell("ip", "link", "set", "up", "dev", "vcan0")


def calibrate():
    shell("canplayer", "-I", "/etc/imucald/shuttle.log", "vcan0=can0")
    time.sleep(1.5)
    said = status()
    return {
        "state": said["state"],
        "yaw": said["mount"]["yaw_deg"],
        "generation": said["saved_state"]["generation"],
        "status": show("StatusText"),
    }


def killed():
    sensor = Sensor()
    wait(lambda: sensor.good_since(0.0))
    times, peer = [], [bare_start()]  # one before and one after each attempt
    for _ in range(KILLS):
        STARTS.unlink()  # each is the first in a minute
        pid = int(show("MainPID"))
        os.kill(pid, signal.SIGKILL)
        began = time.monotonic()
        time.sleep(0.05)  # what was on its way before
        after = time.monotonic()
        wait(lambda after=after: sensor.good_since(after))
        times.append(time.monotonic() - began)
        quality = sensor.quality
        wait(lambda old=pid: show("MainPID") not in ("0", str(old)) and is_active())
        peer.append(bare_start())
    sensor.stop()
    return {
        "times": times,
        "peer": peer,
        "quality": quality,
        "restarts": int(show("NRestarts")),
        "kept": len(list(CACHE.glob("*.json"))),
    }


def is_active():
    return show("ActiveState") == "active"


def crash_loop():
    """A process that ends by SIGSEGV as soon as it is started; the clock was set since the boot."""
    step_clock(-2.0)
    program = pathlib.Path("/usr/bin/imucald")
    good = program.read_text()
    shell("systemctl", "stop", UNIT)
    program.write_text("#!/bin/sh\nkill -SEGV $$\n")
    began = time.monotonic()
    shell("systemctl", "start", UNIT, check=False)
    first = wait(lambda: int(show("NRestarts")) >= 1)
    time.sleep(MINUTE_S - (time.monotonic() - began))
    found = {"first": first, "restarts": int(show("NRestarts"))}
    program.write_text(good)
    shell("systemctl", "stop", UNIT)
    step_clock(2.0)
    shell("systemctl", "start", UNIT)
    return found | {"active": show("ActiveState")}


def step_clock(hours):
    time.clock_settime(time.CLOCK_REALTIME, time.time() + 3600 * hours)


def no_folder():
    """systemd cannot make the folders of the service: nothing of the unit is run."""
    again = f"imucald-again@{UNIT.partition('@')[2]}"
    cache = "/var/cache"

    def fail():
        shell("mount", "-t", "tmpfs", "-o", "ro", "none", cache)
        shell("systemctl", "start", UNIT, check=False)

    shell("systemctl", "stop", UNIT)
    fail()
    before = int(show("NRestarts"))
    time.sleep(10.0)
    found = {"code": show("ExecMainStatus"), "restarts": int(show("NRestarts")) - before}
    shell("umount", cache)
    found["again"] = wait(is_active, 60.0)
    shell("systemctl", "stop", UNIT)
    fail()
    found["waits"] = shell("systemctl", "is-active", again, check=False).strip()
    shell("systemctl", "stop", UNIT)
    found["stopped"] = shell("systemctl", "is-active", again, check=False).strip()
    shell("umount", cache)
    shell("systemctl", "start", UNIT)
    return found


def heavy_database():
    """A database whose comments take more memory to parse than the unit has."""
    heavy = pathlib.Path("/etc/imucald/shuttle.dbc")
    good = heavy.read_bytes()
    heavy.write_bytes(good + b'CM_ "' + b"word " * 1_000_000 + b'";\n')
    pid = show("MainPID")
    refused = subprocess.run(["systemctl", "reload", UNIT], check=False).returncode
    found = {"same_process": show("MainPID") == pid, "refused": refused}
    shell("systemctl", "restart", UNIT, check=False)
    wait(lambda: show("ActiveState") == "failed", 120.0)
    found |= {
        "code": show("ExecMainStatus"),
        "restarts": int(show("NRestarts")),
        "told": "MiB of memory" in journal(20),
    }
    heavy.write_bytes(good)
    shell("systemctl", "start", UNIT)
    return found


def hung():
    """The loop hangs (in a daemon whose loop can be made to); nothing else is wrong with it."""
    folder = pathlib.Path(f"/run/systemd/system/{UNIT}.d")
    folder.mkdir(parents=True)
    (folder / "hang.conf").write_text(
        "[Service]\nExecStart=\nExecStart=/usr/bin/imucald-hanging run"
        " --config /etc/imucald/vcan0.yaml --interface socketcan --channel vcan0\n"
    )
    pathlib.Path("/usr/bin/imucald-hanging").chmod(0o755)
    shell("systemctl", "daemon-reload")
    shell("systemctl", "restart", UNIT)
    restarts = int(show("NRestarts"))
    pid = show("MainPID")
    pathlib.Path("/run/imucald/vcan0/hang").touch()
    took = wait(lambda: show("MainPID") not in ("0", pid) and is_active(), 60.0)
    result = {
        "took": took,
        "restarts": int(show("NRestarts")) - restarts,
        "said": "watchdog" in journal(60).lower(),
    }
    (folder / "hang.conf").unlink()
    folder.rmdir()
    shell("systemctl", "daemon-reload")
    shell("systemctl", "restart", UNIT)
    return result


def reloaded():
    pid, before = show("MainPID"), status()
    config = pathlib.Path("/etc/imucald/vcan0.yaml")
    good = config.read_text()
    config.write_text(good.replace("status_rate: 10", "status_rate: 5"))
    shell("systemctl", "reload", UNIT)
    wait(lambda: "was read again" in journal(20))
    after = status()
    config.write_text(good + "nonsense: 1\n")
    refused = subprocess.run(["systemctl", "reload", UNIT], check=False).returncode
    told = "vcan0.yaml:" in journal(20)
    os.kill(int(pid), signal.SIGHUP)  # whoever leaves systemctl out
    wait(lambda: "not reloaded" in journal(20))
    still = status()
    config.write_text(good)
    return {
        "same_process": show("MainPID") == pid,
        "yaw": [s["mount"]["yaw_deg"] for s in (before, after, still)],
        "refused": refused,
        "told": told,
        "active": show("ActiveState"),
    }


def stopped():
    before = status()
    began = time.monotonic()
    os.kill(int(show("MainPID")), signal.SIGTERM)
    wait(lambda: show("ActiveState") == "inactive")
    took = time.monotonic() - began
    files = sorted(path.name.rsplit(".", 1)[1] for path in STATE.glob("*.state.*"))
    shell("systemctl", "start", UNIT)
    after = status()
    return {
        "took": took,
        "files": files,
        "result": show("Result"),
        "yaw": [before["mount"]["yaw_deg"], after["mount"]["yaw_deg"]],
        "state": after["state"],
    }


def said(*command, user=None):
    """Exit status, and what a command says, as another user if need be."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, user=user)
    return [done.returncode, done.stdout + done.stderr]


def ordered():
    """Orders by root and by others, over the socket of the sandboxed daemon."""
    control = pathlib.Path("/run/imucald/vcan0/control.sock")
    found = {
        "mode": oct(control.stat().st_mode & 0o777),
        "others": said("imucald", "reset", "vcan0", user="nobody"),
        "state": status()["state"],
        "hold": said("imucald", "hold", "vcan0"),
        "held": status()["held"],
    }
    shell("systemctl", "restart", UNIT)
    found["held_after"] = status()["held"]
    found["release"] = said("imucald", "release", "vcan0")
    found["set"] = said("imucald", "set-mount", "vcan0", "0", "0", "25", "--std", "0.5")
    found["yaw"] = status()["mount"]["yaw_deg"]
    found["events"] = said("imucald", "events", "vcan0", user="nobody")
    found["journal"] = journal(20)
    time.sleep(2.5)  # inputs are missed from 2 s on
    found["quiet"] = said("imucald", "status", "vcan0", "-q")
    found["reset"] = said("imucald", "reset", "vcan0")
    found["after"] = status()["state"]
    return found


def metrics():
    """The units for Prometheus as installed."""
    collector = pathlib.Path("/var/lib/prometheus/node-exporter")
    shell("systemctl", "start", "imucald-metrics.service")
    found = {"without_collector": collector.exists()}
    collector.mkdir(parents=True)
    os.chown(collector.parent, 65534, 65534)
    os.chown(collector, 65534, 65534)
    shell("systemctl", "start", "imucald-metrics.timer")
    shell("systemctl", "start", "imucald-metrics.service")
    file = collector / "imucald.prom"
    found |= {
        "mode": oct(file.stat().st_mode & 0o777),
        "text": file.read_text(),
        "timer": shell("systemctl", "is-active", "imucald-metrics.timer").strip(),
    }
    shell("ip", "link", "set", "up", "dev", "lo")
    shell("systemctl", "start", "imucald-metrics-http")
    wait(fetched)
    found["http"] = fetched()
    shell("systemctl", "stop", "imucald-metrics-http", "imucald-metrics.timer")
    return found


def fetched():
    with contextlib.suppress(OSError), urllib.request.urlopen(URL, timeout=5.0) as answer:
        return answer.read().decode()


BUS_UNIT = pathlib.Path("/usr/share/imucald/imucald-bus@.service.example")
DROP_IN = """[Unit]
Requires=imucald-bus@%i.service
After=imucald-bus@%i.service
[Service]
NetworkNamespacePath=/run/netns/imucald-%i
"""


def one_interface():
    """The daemon in a network namespace of its own, behind the kernel's gateway."""
    pathlib.Path("/etc/systemd/system/imucald-bus@.service").write_text(BUS_UNIT.read_text())
    folder = pathlib.Path("/etc/systemd/system/imucald@.service.d")
    folder.mkdir()
    (folder / "one-interface.conf").write_text(DROP_IN)
    shell("ip", "link", "add", "dev", "vcan1", "type", "vcan")
    shell("ip", "link", "set", "up", "dev", "vcan1")
    shell("systemctl", "daemon-reload")
    shell("systemctl", "stop", UNIT)
    shell("systemctl", "start", UNIT)
    sensor, inside = Sensor(), ("ip", "netns", "exec", "imucald-vcan0")
    took = wait(lambda: sensor.good_since(0.0))
    dump = subprocess.Popen(
        ["candump", "-n", "500", "-T", "3000", "-L", "vcan0"], stdout=subprocess.PIPE, text=True
    )
    time.sleep(0.5)
    for frame in ("123#DEAD", "64F#BEEF"):
        shell(*inside, "cansend", "vcan0", frame)
    other = subprocess.run([*inside, "cansend", "vcan1", "64F#00"], check=False).returncode
    sensor.stop()
    heard = dump.communicate()[0]
    names = [line.split()[1].strip(":") for line in shell(*inside, "ip", "-o", "link").splitlines()]
    found = {
        "took": took,
        "interfaces": sorted(name.partition("@")[0] for name in names),
        "allowed": "64F#BEEF" in heard,
        "foreign": "123#DEAD" in heard,
        "other": other,
        "active": show("ActiveState"),
    }
    (folder / "one-interface.conf").unlink()
    shell("systemctl", "stop", UNIT, "imucald-bus@vcan0.service")
    shell("systemctl", "daemon-reload")
    shell("systemctl", "start", UNIT)
    return found


def bare_start():
    """Seconds in which this machine starts a transient unit of Python that imports and ends."""
    began = time.monotonic()
    shell(*BARE)
    return time.monotonic() - began


def interface_lost():
    sensor = Sensor()
    wait(lambda: sensor.good_since(0.0))
    times, peer = [], [bare_start()]  # one before and one after each attempt
    for _ in range(DELETIONS):
        shell("ip", "link", "del", "dev", "vcan0")
        wait(lambda: show("ActiveState") == "inactive")
        make_interface()
        began = time.monotonic()
        wait(lambda after=began: sensor.good_since(after))
        times.append(time.monotonic() - began)
        wait(is_active)
        peer.append(bare_start())
    down = []
    pid = show("MainPID")
    for _ in range(3):
        shell("ip", "link", "set", "down", "dev", "vcan0")
        time.sleep(0.3)
        shell("ip", "link", "set", "up", "dev", "vcan0")
        began = time.monotonic()
        wait(lambda after=began: sensor.good_since(after))
        down.append(time.monotonic() - began)
    sensor.stop()
    same = show("MainPID") == pid
    return {"times": times, "peer": peer, "down": down, "same_process": same}


def clock_stepped():
    sensor = Sensor()
    wait(lambda: sensor.good_since(0.0))
    found = []
    for hours in (0, 1, -1, -1, 1):
        step_clock(hours)
        after = time.monotonic() + 0.1
        wait(lambda after=after: sensor.good_since(after))
        time.sleep(0.5)
        said = status()
        found.append([said["mount"][f"{a}_deg"] for a in ("roll", "pitch", "yaw")])
        found[-1] += [*sensor.values, said["quality"]]
    sensor.stop()
    return {"found": found}


def calibrate_again():
    """After the state was set aside."""
    return calibrate()


def corrupted():
    shell("systemctl", "stop", UNIT)
    for path in list(STATE.iterdir()):
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 4
        path.write_bytes(data)
    shell("systemctl", "start", UNIT)
    said = status()
    aside = [path.name for path in STATE.iterdir() if ".corrupt." in path.name]
    return {
        "state": said["state"],
        "quality": said["quality"],
        "problems": said["saved_state"]["problems"],
        "aside": aside,
        "told": "its checksum or its length is wrong" in journal(20),
    }


def misconfigured():
    config = pathlib.Path("/etc/imucald/vcan0.yaml")
    config.write_text(config.read_text().replace("speed: SPEED.V", "sped: SPEED.V"))
    shell("systemctl", "restart", UNIT, check=False)
    time.sleep(1.5)
    return {
        "active": show("ActiveState"),
        "code": show("ExecMainStatus"),
        "told": "vcan0.yaml:" in journal(20),
    }


SCENES = (
    begin,
    calibrate,
    killed,
    hung,
    reloaded,
    stopped,
    crash_loop,
    no_folder,
    heavy_database,
    one_interface,
    interface_lost,
    clock_stepped,
    corrupted,
    calibrate_again,
    metrics,
    ordered,
    misconfigured,
)

if __name__ == "__main__":
    for scene in SCENES:
        start = time.monotonic()
        outcome = scene()
        outcome["seconds"] = round(time.monotonic() - start, 2)
        print("RESULT", json.dumps({scene.__name__: outcome}), flush=True)
    sys.exit(0)
