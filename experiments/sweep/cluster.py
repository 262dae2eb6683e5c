"""The same chunks over a Ray cluster: every chunk is a task, and this process alone writes files.

The nodes need this repository at the same path, with its environment. Without an address, and without one in
`RAY_ADDRESS`, a cluster of `workers` processes is started here and stopped at the end.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from experiments import Refused, engines, manifest
from experiments.sweep.design import Design
from experiments.sweep.progress import Progress
from experiments.sweep.run import code_hash, fly_chunk

QUEUED_PER_CPU = 2
"""Tasks under way or waiting, per processor: so many chunks can be in memory at once, and no more."""


class OtherBuild(Exception):
    """A node has other code."""


@dataclass(frozen=True)
class Ray:
    """A Ray cluster."""

    address: str | None = None
    workers: int | None = None

    def fly(
        self,
        design: Design,
        chunks: list[int],
        progress: Progress,  # noqa: ARG002 - a cluster reports whole chunks only
    ) -> Iterator[tuple[int, Any]]:
        """Yield chunks as the cluster ends them."""
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
            yield from _spread(ray, design, chunks)
        finally:
            if started:
                ray.shutdown()


def _connect(ray: Any, address: str | None, workers: int | None) -> None:
    # The driver's folder is not on the path of its workers when it was started as `python -m`.
    environment = {"env_vars": {"PYTHONPATH": str(manifest.REPOSITORY)}}
    quiet = {"log_to_driver": False, "logging_level": "error", "runtime_env": environment}
    if address:
        ray.init(address=address, **quiet)
    else:
        ray.init(num_cpus=workers or os.cpu_count() or 1, include_dashboard=False, **quiet)


def _spread(ray: Any, design: Design, chunks: list[int]) -> Iterator[tuple[int, Any]]:
    # The design travels once, read and resolved: nodes read nothing but the robot's files.
    shared = ray.put(pickle.dumps((design.spec, design.bases)))
    task = ray.remote(num_cpus=1, max_retries=2)(_fly_remotely)
    limit = QUEUED_PER_CPU * max(1, int(ray.cluster_resources().get("CPU", 1)))
    waiting, expected = list(chunks), code_hash(design)
    running: dict[Any, int] = {}
    while waiting or running:
        while waiting and len(running) < limit:
            chunk = waiting.pop(0)
            running[task.remote(shared, chunk, expected)] = chunk
        (done, *_), _ = ray.wait(list(running), num_returns=1)
        chunk = running.pop(done)
        try:
            yield chunk, ray.get(done)
        except ray.exceptions.RayTaskError as error:
            if isinstance(error.cause, OtherBuild):
                raise Refused(str(error.cause)) from None
            raise
        except ray.exceptions.RayError as reason:  # its process was killed, again and again
            raise Refused(f"chunk {chunk} did not come back ({reason}); the same command goes on with it") from None


def _fly_remotely(shared: bytes, chunk: int, expected: str) -> Any:
    spec, bases = pickle.loads(shared)
    design = Design(spec)
    vars(design)["bases"] = bases
    if (found := code_hash(design)) != expected:
        raise OtherBuild(f"a node has other code ({found}, here {expected})")
    return fly_chunk(design, chunk, engines.engine(spec.engine), threads=1)
