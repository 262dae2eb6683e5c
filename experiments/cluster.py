"""Independent jobs over a Ray cluster: every job is a task, and this process alone writes files.

The nodes need this repository at the same path, with its environment. Without an address, and without one in
`RAY_ADDRESS`, a cluster of `workers` processes is started here and stopped at the end.
"""

from __future__ import annotations

import argparse
import os
import pickle
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from experiments import Refused, sources
from jax_aero import places
from jax_aero.cli import count

Key = TypeVar("Key")
Shared = TypeVar("Shared")
Job = TypeVar("Job")
Answer = TypeVar("Answer")

QUEUED_PER_CPU = 2
"""Tasks under way or waiting, per processor: so many answers can be in memory at once, and no more."""


def add_options(parser: argparse.ArgumentParser, jobs: str, workers: str) -> None:
    """Add `--workers`, `--cluster` and `--address`; `jobs` names what is spread, `workers` what is counted."""
    parser.add_argument("--workers", type=count, metavar="N", help=f"{workers} (default: one per core)")
    parser.add_argument("--cluster", choices=["ray"], help=f"spread {jobs} over a cluster")
    parser.add_argument("--address", metavar="ADDRESS", help="of the cluster (default: RAY_ADDRESS, or a local one)")


@dataclass(frozen=True)
class Ray:
    """A Ray cluster."""

    address: str | None = None
    workers: int | None = None

    @classmethod
    def of(cls, given: argparse.Namespace) -> Ray | None:
        """Return the cluster that the options of `add_options` ask for."""
        if given.address and not given.cluster:
            raise Refused(f"--address is {given.address}; expected --cluster ray beside it")
        return cls(given.address, given.workers) if given.cluster else None

    def spread(
        self,
        task: Callable[[Shared, Job], Answer],
        shared: Shared,
        jobs: Mapping[Key, Job],
        modules: tuple[str, ...],
        cpus: int = 1,
    ) -> Iterator[tuple[Key, Answer]]:
        """Yield the answers `task(shared, job)` by the keys of their jobs, as they end.

        Parameters
        ----------
        task
            A function of a module that the nodes can import.
        modules
            Modules whose code, with all that they import, makes the answers: a node must have the same.
        cpus
            Processors that a task takes.
        """
        try:
            import ray
        except ImportError:
            raise Refused(
                "--cluster ray needs the package `ray`; the extra `cluster` of this package brings it"
            ) from None
        address = self.address or os.environ.get("RAY_ADDRESS")
        started = not ray.is_initialized()
        if started:
            _connect(ray, address, self.workers)
        try:
            # What all share travels once.
            common = ray.put(pickle.dumps((task, shared, modules, sources.code_hash(*modules))))
            yield from _spread(ray, common, jobs, cpus)
        finally:
            if started:
                ray.shutdown()


def _connect(ray: Any, address: str | None, workers: int | None) -> None:
    # The driver's folder is not on the path of its workers when it was started as `python -m`.
    environment = {"env_vars": {"PYTHONPATH": str(places.HOME)}}
    quiet = {"log_to_driver": False, "logging_level": "error", "runtime_env": environment}
    if address:
        ray.init(address=address, **quiet)
        return
    local = {"num_cpus": workers or os.cpu_count() or 1, "include_dashboard": False, **quiet}
    try:
        ray.init(**local)
    except Exception:  # Ray gives its processes 30 s to start, which a busy machine may need the first time
        ray.shutdown()
        ray.init(**local)


def _spread(ray: Any, common: Any, jobs: Mapping[Key, Any], cpus: int) -> Iterator[tuple[Key, Any]]:
    task = ray.remote(num_cpus=cpus, max_retries=2)(_remotely)
    available = int(ray.cluster_resources().get("CPU", 1))
    if cpus > available:
        raise Refused(f"a task takes {cpus} processors, and the cluster has {available}")
    limit = QUEUED_PER_CPU * max(1, available // cpus)
    waiting = list(jobs)
    running: dict[Any, Key] = {}
    while waiting or running:
        while waiting and len(running) < limit:
            key = waiting.pop(0)
            running[task.remote(common, jobs[key])] = key
        (done, *_), _ = ray.wait(list(running), num_returns=1)
        key = running.pop(done)
        try:
            yield key, ray.get(done)
        except ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, Refused):
                raise Refused(str(error.cause)) from None
            raise
        except ray.exceptions.RayError as reason:  # its process was killed, again and again
            raise Refused(f"job {key} did not come back ({reason}); the same command goes on with it") from None


def _remotely(common: bytes, job: Any) -> Any:
    task, shared, modules, expected = pickle.loads(common)
    if (found := sources.code_hash(*modules)) != expected:
        raise Refused(f"a node has other code ({found}, here {expected})")
    return task(shared, job)
