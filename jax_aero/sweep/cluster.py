"""Independent jobs on a Ray cluster: every job is a task, and only this process writes files.

The nodes need this repository and its environment at the same path. Without an address, given or in `RAY_ADDRESS`, a
local cluster of `workers` processes is started, which this machine alone can reach, and stopped at the end.
"""

from __future__ import annotations

import argparse
import os
import pickle
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from jax_aero.base.arguments import count
from jax_aero.base.terminal import Refused, missing_package
from jax_aero.results import manifest
from jax_aero.results.identity import VERSIONS

Key = TypeVar("Key")
Shared = TypeVar("Shared")
Job = TypeVar("Job")
Answer = TypeVar("Answer")

QUEUED_PER_CPU = 2
"""Submitted tasks per processor, which limits the number of answers in memory."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add `--workers`, `--cluster` and `--address`."""
    about = "threads, or processes of a local cluster (default: one per core)"
    parser.add_argument("--workers", type=count, metavar="N", help=about)
    parser.add_argument("--cluster", choices=["ray"], help="spread chunks over a cluster")
    parser.add_argument("--address", metavar="ADDRESS", help="of the cluster (default: RAY_ADDRESS, or a local one)")


@dataclass(frozen=True)
class Ray:
    """A Ray cluster."""

    address: str | None = None
    workers: int | None = None

    @classmethod
    def from_options(cls, given: argparse.Namespace) -> Ray | None:
        """Return the cluster chosen by the options of `add_options`, or `None`."""
        if given.address and not given.cluster:
            raise Refused(f"--address is {given.address}; expected --cluster ray beside it")
        return cls(given.address, given.workers) if given.cluster else None

    def spread(
        self,
        task: Callable[[Shared, Job], Answer],
        shared: Shared,
        jobs: Mapping[Key, Job],
    ) -> Iterator[tuple[Key, Answer]]:
        """Yield the answers `task(shared, job)` with the keys of their jobs, in order of completion.

        The task is a function in a module that the nodes can import, and takes one processor.
        """
        try:
            import ray
        except ModuleNotFoundError as missing:
            raise Refused(missing_package("--cluster ray", missing, "cluster")) from None
        address = self.address or os.environ.get("RAY_ADDRESS")
        started = not ray.is_initialized()
        if started:
            _connect(ray, address, self.workers)
        try:
            # Shared data are transferred once.
            common = ray.put(pickle.dumps((task, shared, VERSIONS)))
            yield from _spread(ray, common, jobs)
        finally:
            if started:
                ray.shutdown()


ONLY_HERE = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"
"""Variable that Ray reads when it is imported: with 0 its processes listen on the loopback address, on every system."""


def _connect(ray: Any, address: str | None, workers: int | None) -> None:
    # The driver's folder is not on the workers' path if it was started as `python -m`.
    environment = {"env_vars": {"PYTHONPATH": str(Path(__file__).parents[2])}}
    quiet = {"log_to_driver": False, "logging_level": "error", "runtime_env": environment}
    if address:
        ray.init(address=address, **quiet)
        return
    os.environ[ONLY_HERE] = "0"
    ray._private.ray_constants.ENABLE_RAY_CLUSTER = False  # here, where it is imported already
    local = {"num_cpus": workers or manifest.processors(), "include_dashboard": False, **quiet}
    try:
        ray.init(**local)
    except Exception:  # Ray's time-out of 30 s may be too short on a busy machine
        ray.shutdown()
        ray.init(**local)


def _spread(ray: Any, common: Any, jobs: Mapping[Key, Any]) -> Iterator[tuple[Key, Any]]:
    task = ray.remote(num_cpus=1, max_retries=2)(_run_remotely)
    limit = QUEUED_PER_CPU * max(1, int(ray.cluster_resources().get("CPU", 1)))
    waiting = iter(jobs)
    running: dict[Any, Key] = {}
    while True:
        for key in islice(waiting, limit - len(running)):
            running[task.remote(common, jobs[key])] = key
        if not running:
            return
        (done, *_), _ = ray.wait(list(running), num_returns=1)
        key = running.pop(done)
        try:
            yield key, ray.get(done)
        except ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, Refused):
                raise Refused(str(error.cause)) from None
            raise
        except ray.exceptions.RayError as reason:  # its process was killed repeatedly
            raise Refused(f"job {key} did not come back ({reason}); the same command goes on with it") from None


@lru_cache(maxsize=1)
def _unpacked(common: bytes) -> Any:
    """Return what all jobs share, made once in each process."""
    return pickle.loads(common)


def _run_remotely(common: bytes, job: Any) -> Any:
    task, shared, expected = _unpacked(common)
    if expected != VERSIONS:
        raise Refused(f"a node has other numerics ({VERSIONS}, here {expected})")
    return task(shared, job)
