import sys
import tomllib
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

import pytest

from fbench.replay.geometry.threads import num_threads
from fbench.replay.runs.host import EnergyMeter, compare_hosts, describe_host, measure_reference_ms, peak_memory_mib
from fbench.replay.runs.manifest import package_versions

NO_MATTER = {
    "foxglove-schemas-protobuf", "isal", "jinja2", "lz4", "pandas", "platformdirs", "pydantic", "rich", "ruamel.yaml",
    "typer", "xxhash", "zstandard",
}  # fmt: skip
"""They show things, check them, or give back exactly what went in."""


def test_every_package_that_decides_results_is_listed():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = {line.partition(">=")[0].strip() for line in project["dependencies"]}
    listed = package_versions()
    assert needed == (set(listed) - {"fbench", "python", "llvmlite", "av"}) | NO_MATTER
    assert "absent" not in listed.values()
    assert ("av" in listed) == (find_spec("av") is not None), "which is an extra"


def test_the_host_is_told(tmp_path):
    found = describe_host(tmp_path)
    assert list(found)[:4] == ["cpu", "cores", "platform", "python"]
    assert found["threads"] == num_threads()
    assert found["governor"] is None
    clock = tmp_path / "devices/system/cpu/cpu0/cpufreq"
    clock.mkdir(parents=True)
    (clock / "scaling_governor").write_text("powersave\n")
    assert describe_host(tmp_path)["governor"] == "powersave"


def test_the_reference_kernel_and_memory():
    assert 0 < measure_reference_ms() == measure_reference_ms()
    assert peak_memory_mib() > 20


def write_rapl(folder, **used_uj):
    for name, used in used_uj.items():
        path = folder / "class/powercap" / name.replace("_", ":").replace("rapl", "intel-rapl")
        path.mkdir(parents=True, exist_ok=True)
        (path / "energy_uj").write_text(f"{used}\n")
        (path / "max_energy_range_uj").write_text("10000000\n")


def test_energy_of_all_processors_also_where_a_counter_begins_again(tmp_path):
    write_rapl(tmp_path, rapl_0=1_000_000, rapl_1=9_000_000, rapl_0_0=5)
    begin = EnergyMeter.read(tmp_path)
    write_rapl(tmp_path, rapl_0=3_500_000, rapl_1=1_000_000, rapl_0_0=7_000_000)
    found = begin.describe_use(tmp_path)
    assert found["cpu_energy_j"] == 2.5 + 2.0  # parts of a processor don't count twice
    assert "cpu_energy_reason" not in found


def test_energy_that_nobody_tells_is_null_with_a_reason(tmp_path):
    write_rapl(tmp_path)
    assert EnergyMeter.read(tmp_path).describe_use(tmp_path)["cpu_energy_reason"] == "no RAPL counter can be read"
    (tmp_path / "class/powercap").mkdir(parents=True)
    found = EnergyMeter.read(tmp_path).describe_use(tmp_path)
    assert (found["cpu_energy_j"], found["cpu_energy_reason"]) == (None, "no RAPL counter here")
    write_rapl(tmp_path, rapl_0="many")
    assert EnergyMeter.read(tmp_path).describe_use(tmp_path)["cpu_energy_reason"] == "no RAPL counter can be read"


class Nvml(ModuleType):
    """Two GPUs, each of which uses 3 J between two looks."""

    class NVMLError(Exception):
        pass

    used_mj = 1000
    nvmlInit = nvmlShutdown = staticmethod(lambda: None)
    nvmlDeviceGetCount = staticmethod(lambda: 2)
    nvmlDeviceGetHandleByIndex = staticmethod(lambda index: index)

    def nvmlDeviceGetTotalEnergyConsumption(self, handle):
        self.used_mj += 1500
        return self.used_mj


def test_energy_of_gpus(monkeypatch, tmp_path):
    nvml = Nvml("pynvml")
    nvml.__spec__ = ModuleSpec("pynvml", None)
    monkeypatch.setitem(sys.modules, "pynvml", nvml)
    assert EnergyMeter.read(tmp_path).describe_use(tmp_path)["gpu_energy_j"] == 6.0

    def fail(self, handle):
        raise Nvml.NVMLError("Not Supported")

    monkeypatch.setattr(Nvml, "nvmlDeviceGetTotalEnergyConsumption", fail)
    found = EnergyMeter.read(tmp_path).describe_use(tmp_path)
    assert (found["gpu_energy_j"], found["gpu_energy_reason"]) == (None, "NVML gives no energy (Not Supported)")


HOST = {"cpu": "A", "cores": 4, "governor": "performance", "threads": 4, "reference_ms": 10.0}


@pytest.mark.parametrize(
    ("head", "reasons"),
    [
        ({}, []),
        ({"reference_ms": 11.0}, []),
        ({"reference_ms": 8.9}, ["the reference kernel took 10 ms and 8.9 ms"]),
        ({"reference_ms": 11.1}, ["the reference kernel took 10 ms and 11.1 ms"]),
        ({"cpu": "B", "threads": 1}, ["cpu A and B", "threads 4 and 1"]),
        ({"overlap": 2}, ["frames overlapped in 1 and 2 processes"]),
        ({"governor": None, "load": 9.0}, ["governor performance and unknown"]),
        ({"reference_ms": None}, ["the time of the reference kernel isn't known of both"]),
    ],
)
def test_hosts_whose_latencies_can_not_be_compared(head, reasons):
    assert compare_hosts(HOST, HOST | head) == reasons
    assert len(compare_hosts(HOST | head, HOST)) == len(reasons)
