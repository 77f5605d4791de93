"""How many processes work, and what each of them may use."""

from __future__ import annotations

import logging
from dataclasses import dataclass

from volatool.errors import ResourceError
from volatool.resources import n_cores
from volatool.units import format_size

LEAST_MEMORY_BYTES = 256 << 20
"""A worker needs so much: its libraries and kernels, and arrays that are worth the name."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Share:
    """
    What a run is shared out to.

    Parameters
    ----------
    jobs : int
        Number of processes; 1 means this one.
    threads : int
        Cores of each.
    memory : int
        Ceiling of each, in bytes.
    """

    jobs: int
    threads: int
    memory: int


def share_out(jobs: int | None, memory: int, n_inputs: int) -> Share:
    """
    Share cores and memory out to processes.

    Parameters
    ----------
    jobs : int or None
        How many are asked for; None chooses: as many as there are cores, if the memory is enough
        for them.
    memory : int
        Ceiling for all of them together, in bytes.
    n_inputs : int
        More processes than inputs would be idle.

    Raises
    ------
    ResourceError
        ``E_MEMORY``: the share of each would be too small to work with.
    """
    cores = n_cores()
    if jobs is None:
        jobs = max(1, min(cores, memory // LEAST_MEMORY_BYTES))
        if jobs < min(cores, n_inputs):
            logger.warning(
                "%d of %d cores: --memory %s is %s for each; raise it to use more",
                *(jobs, cores, format_size(memory), format_size(memory // jobs)),
            )
    jobs = max(1, min(jobs, n_inputs))
    if jobs > 1 and memory // jobs < LEAST_MEMORY_BYTES:
        raise ResourceError(
            f"--memory {format_size(memory)} is {format_size(memory // jobs)} for each of {jobs} "
            f"processes, which need {format_size(LEAST_MEMORY_BYTES)}; raise it to "
            f"{format_size(jobs * LEAST_MEMORY_BYTES)}, or lower --jobs"
        )
    return Share(jobs, max(1, cores // jobs), memory // jobs)
