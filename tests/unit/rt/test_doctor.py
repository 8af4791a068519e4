"""dftc doctor, against machines made of plain values."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from dftc_rt.cli import doctor as command
from dftc_rt.cli.main import build
from dftc_rt.rt.doctor import OPTIONAL, REQUIRED, Check, examine
from dftc_rt.rt.machine import Machine

pytestmark = pytest.mark.realtime

GOVERNOR = "/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"


@dataclass
class FakeMachine(Machine):
    """A machine that has everything, but for what a test takes away."""

    python: tuple[int, int] = (3, 11)
    system: str = "Linux"
    cores: int = 2
    kernel_caches: tuple[str, ...] = ("/package", "/cache")
    files: dict[str, str] = field(
        default_factory=lambda: {
            "/proc/sys/kernel/sched_rt_runtime_us": "950000",
            "/proc/sys/kernel/sched_rt_period_us": "1000000",
            "/sys/kernel/realtime": "1",
            "/proc/version": "Linux version 6.1.0-rt (builder) #1 SMP",
            "/dev/cpu_dma_latency": "",
            GOVERNOR: "performance",
        }
    )
    unwritable: tuple[str, ...] = ()
    modules: frozenset[str] = frozenset((*REQUIRED, *OPTIONAL))
    programs: tuple[str, ...] = ("cyclictest",)
    links: tuple[str, ...] = ("vcan0",)
    fifo: str = ""
    mlockall: str = ""
    can: str = ""
    seqpacket: str = ""
    directory: str = ""

    def read(self, path: str) -> str | None:
        return self.files.get(path)

    def paths(self, pattern: str) -> list[str]:
        return [p for p in self.files if Path(p).match(pattern)]

    def bus_directory(self) -> tuple[Path, str]:
        return Path("/run/user/1/dftc"), self.directory

    def writable(self, path: str) -> bool:
        return path not in self.unwritable

    def program(self, name: str) -> str:
        return f"/usr/bin/{name}" if name in self.programs else ""

    def has_module(self, name: str) -> bool:
        return name in self.modules

    def vcan_links(self) -> list[str]:
        return list(self.links)

    def refuses_fifo(self) -> str:
        return self.fifo

    def refuses_mlockall(self) -> str:
        return self.mlockall

    def refuses_can(self) -> str:
        return self.can

    def refuses_seqpacket(self) -> str:
        return self.seqpacket


def without(path: str, **changed: str) -> dict[str, str]:
    files = {k: v for k, v in FakeMachine().files.items() if k != path}
    return files | changed


def lacking(machine: Machine) -> list[Check]:
    return [check for check in examine(machine) if not check.ok]


def test_complete_machine_lacks_nothing() -> None:
    assert lacking(FakeMachine()) == []


@pytest.mark.parametrize(
    ("name", "essential", "change"),
    [
        ("python", True, {"python": (3, 10)}),
        ("operating system", True, {"system": "Darwin"}),
        ("python packages", True, {"modules": frozenset(OPTIONAL) | set(REQUIRED[1:])}),
        ("AF_UNIX SOCK_SEQPACKET", True, {"seqpacket": "Operation not permitted"}),
        ("processor cores", False, {"cores": 1}),
        ("SCHED_FIFO", False, {"fifo": "Operation not permitted"}),
        ("locked memory", False, {"mlockall": "Cannot allocate memory"}),
        ("processor sleep states", False, {"files": without("/dev/cpu_dma_latency")}),
        ("processor sleep states", False, {"unwritable": ("/dev/cpu_dma_latency",)}),
        ("PREEMPT_RT kernel", False, {"files": without("/sys/kernel/realtime")}),
        ("frequency governor", False, {"files": {**FakeMachine().files, GOVERNOR: "powersave"}}),
        (
            "real-time throttling",
            False,
            {"files": {**FakeMachine().files, "/proc/sys/kernel/sched_rt_runtime_us": "100000"}},
        ),
        ("bus directory", False, {"directory": "mode 0755"}),
        ("kernel CAN (AF_CAN)", False, {"can": "Address family not supported by protocol"}),
        ("vcan links", False, {"links": ()}),
        ("cyclictest", False, {"programs": ()}),
        ("numba cache", False, {"unwritable": ("/package", "/cache")}),
        ("extra figures", False, {"modules": frozenset(REQUIRED) | set(OPTIONAL) - {"matplotlib"}}),
    ],
)
def test_what_lacks_is_found_with_a_remedy(
    name: str, essential: bool, change: dict[str, object]
) -> None:
    (found,) = lacking(replace(FakeMachine(), **change))  # type: ignore[arg-type]
    assert (found.name, found.essential) == (name, essential)
    assert found.found
    assert found.means
    assert found.remedy


@pytest.mark.parametrize("runtime", ["-1", "950000", "1000000"])
def test_full_real_time_share_is_accepted(runtime: str) -> None:
    files = {**FakeMachine().files, "/proc/sys/kernel/sched_rt_runtime_us": runtime}
    assert lacking(FakeMachine(files=files)) == []


def test_one_writable_kernel_cache_is_enough() -> None:
    checks = {c.name: c for c in examine(FakeMachine(unwritable=("/package",)))}
    assert checks["numba cache"].found == "/cache"


def test_only_what_is_built_is_named() -> None:
    app = build()
    nothing = FakeMachine(
        cores=1, kernel_caches=(), files={}, modules=frozenset(), programs=(), links=(),
        fifo="no", mlockall="no", can="no", seqpacket="no", directory="no",
    )  # fmt: skip
    text = "\n".join(f"{check.means}\n{check.remedy}" for check in examine(nothing))
    commands = set(re.findall(r"\bdftc ([a-z]+)", text))
    assert commands >= {"rig", "control", "hil"}
    assert commands <= set(app)
    options = set(re.findall(r"(--(?:bus|view|lockstep)[a-z-]*)", text))
    assert options <= {"--bus", "--bus-dir", "--lockstep"}
    for target in re.findall(r"\bmake ([a-z-]+) has", text):
        assert f"\n{target}:" in (Path(__file__).parents[3] / "Makefile").read_text()


def test_json_is_one_object_and_exit_code_tells_essentials(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "examine", lambda: examine(FakeMachine(links=())))
    assert command.doctor(json=True) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["ok"] is True
    assert [c["name"] for c in out["checks"] if not c["ok"]] == ["vcan links"]
    monkeypatch.setattr(command, "examine", lambda: examine(FakeMachine(system="Darwin")))
    assert command.doctor(json=True) == 3
    assert json.loads(capsys.readouterr().out)["ok"] is False


def test_table_names_remedies(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(command, "examine", lambda: examine(FakeMachine(programs=())))
    assert command.doctor() == 0
    out = capsys.readouterr().out
    assert "apt-get install rt-tests" in out
    assert "modprobe" not in out


def test_this_machine_answers_every_question() -> None:
    checks = examine()
    assert all(check.found for check in checks)
    assert {c.name for c in checks if c.essential and not c.ok} == set()
