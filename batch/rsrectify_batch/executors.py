# SPDX-License-Identifier: MIT OR Apache-2.0

"""Where steps are carried out: by processes of this machine, or by those of a Ray cluster."""

import asyncio
import socket
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from .program import Program
from .steps import carry_out


class WorkerLost(Exception):
    """A step whose worker, or the machine it was on, is gone."""


class ClusterError(Exception):
    """A cluster that cannot be used."""


class Local:
    """Processes of this machine."""

    def __init__(self, workers: int):
        self.slots = workers
        self._threads = ThreadPoolExecutor(workers)

    async def run(self, step: str, arguments: tuple[Any, ...]) -> dict[str, Any]:
        return await asyncio.get_running_loop().run_in_executor(self._threads, carry_out, step, arguments)

    def close(self) -> None:
        Program.stop_all()
        self._threads.shutdown(cancel_futures=True)


class Ray:
    """Workers of a Ray cluster, each with so many processors; this package and the program are installed on all of its machines,
    which see the clips and the output under the same paths."""

    def __init__(self, address: str, processors: float):
        try:
            import ray
        except ImportError as error:
            raise ClusterError("Ray is not installed: pip install 'rsrectify-batch[ray]'") from error
        self._ray = ray
        _reach(address)
        try:
            ray.init(address=address, log_to_driver=False, logging_level="error")
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise ClusterError(f"Ray: {error}") from error
        # A step is tried again by who asked for it, wherever the error comes from.
        self._remote = ray.remote(num_cpus=processors, max_retries=0, scheduling_strategy="SPREAD")(carry_out)
        self._references: set[Any] = set()
        # So many wait beside those that run that no worker is idle until the next one comes.
        self.slots = 2 * max(1, int(ray.cluster_resources().get("CPU", 0) // processors))

    async def run(self, step: str, arguments: tuple[Any, ...]) -> dict[str, Any]:
        reference = self._remote.remote(step, arguments)
        self._references.add(reference)
        try:
            result: dict[str, Any] = await reference
            return result
        except (self._ray.exceptions.WorkerCrashedError, self._ray.exceptions.NodeDiedError) as error:
            raise WorkerLost(str(error).splitlines()[0]) from error
        except self._ray.exceptions.RayTaskError as error:
            raise error.as_instanceof_cause() from error
        finally:
            self._references.discard(reference)

    def close(self) -> None:
        for reference in self._references:
            self._ray.cancel(reference, force=True)
        self._ray.shutdown()


def _reach(address: str) -> None:
    """Says at once that nobody listens at an address, where Ray would try for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not port.isdecimal():
        # Such as `auto`, which Ray looks up.
        return
    try:
        socket.create_connection((host, int(port)), timeout=10).close()
    except OSError as error:
        raise ClusterError(f"Ray: there is no cluster at {address}: {error}") from error
