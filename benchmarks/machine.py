"""What the numbers were measured on."""

from __future__ import annotations

import hashlib
import os
import platform
import statistics
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("volatool", "numpy", "numba", "lazrs", "laspy", "rasterio", "scipy")


def describe() -> dict[str, Any]:
    """Return the machine, the versions and the load of the last minutes."""
    return {
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "worth_cores": worth_cores(),
        "memory_gib": round(_memory_bytes() / 2**30, 1),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in PACKAGES},
        "commit": _commit(),
        "load": load(),
    }


def load() -> list[float]:
    """Return how many processes wanted to run in the last 1, 5 and 15 minutes."""
    return [round(value, 1) for value in os.getloadavg()]


def worth_cores() -> float:
    """
    Tell how many times as fast all cores together are as one alone, just now.

    What a virtual machine calls cores may be threads of the same core, at times.
    """
    cores, data = os.cpu_count() or 1, bytes(1 << 25)

    def seconds(n: int) -> float:
        begun = time.perf_counter()
        with ThreadPoolExecutor(n) as pool:  # hashing large data lets the interpreter lock go
            list(pool.map(lambda _: hashlib.blake2b(data).digest(), range(n)))
        return time.perf_counter() - begun

    return round(statistics.median(cores * seconds(1) / seconds(cores) for _ in range(9)), 2)


def line(machine: dict[str, Any]) -> str:
    """Return the description as one line of text."""
    packages = ", ".join(f"{name} {number}" for name, number in machine["packages"].items())
    loads = ", ".join(map(str, machine["load"]))
    return (
        f"{machine['cpu']}, {machine['cores']} cores (worth {machine.get('worth_cores', '?')}), "
        f"{machine['memory_gib']} GiB, {machine['system']}, Python {machine['python']}, "
        f"{packages}, commit {machine['commit']}, load {loads}"
    )


def is_same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Tell whether ratios of two machines can be held against each other."""
    return all(one[name] == other[name] for name in ("cpu", "cores", "system"))


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [text.split(":", 1)[1].strip() for text in lines if text.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown CPU"


def _memory_bytes() -> int:
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _commit() -> str | None:
    command = ["git", "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(
            command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
