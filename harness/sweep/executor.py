"""What makes the chunks of a sweep: threads, or the workers of a Dask cluster."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from bristle.common.errors import BristleError
from bristle.harness.sweep.chunk import Rows, Watcher, run_chunk
from bristle.harness.sweep.design import SweepPoint
from bristle.harness.sweep.ship import packed
from bristle.harness.sweep.spec import Sweep

CLUSTER_ADDRESS = re.compile(r"[a-z]+://\S+:\d+")


@dataclass(frozen=True)
class Means:
    """How a sweep is made.

    Attributes
    ----------
    jobs : int
        Threads; not used with a cluster.
    cluster : str, optional
        Address of the scheduler of a Dask cluster.
    resume : bool
        Go on with a store that has runs already.
    command : str
        For the provenance.
    """

    jobs: int = 1
    cluster: str | None = None
    resume: bool = False
    command: str = ""


@contextmanager
def executor(
    sweep: Sweep, means: Means, watcher: Watcher
) -> Iterator[tuple[Callable[[list[SweepPoint]], Future[Rows]], int]]:
    """Give what takes chunks, and how many it works on at once; leaving the context in an error
    stops all of them.
    """
    with ExitStack() as stack:
        if means.cluster is None:
            pool: Executor = stack.enter_context(ThreadPoolExecutor(means.jobs))
            try:
                yield lambda points: pool.submit(run_chunk, sweep, points, watcher), means.jobs
            except BaseException:
                watcher.stop()
                pool.shutdown(cancel_futures=True)
                raise
            return
        client = stack.enter_context(_client(means.cluster))
        workers = sum(client.nthreads().values())
        if not workers:
            raise BristleError(
                f"cluster {means.cluster}: has no workers; start some with dask worker"
                f" {means.cluster}"
            )
        shipped = client.scatter(packed(sweep), broadcast=True, hash=False)
        remote = client.get_executor(pure=False)
        try:
            yield lambda points: remote.submit(run_chunk, shipped, points), workers
        except BaseException:
            remote.shutdown(wait=False)  # which cancels what is waiting or under way
            raise


def _client(address: str) -> Any:
    if CLUSTER_ADDRESS.fullmatch(address) is None:
        raise BristleError(
            f"cluster {address}: is no address of a Dask scheduler; write for example"
            " tcp://host:8786"
        )
    try:
        client: Any = import_module("distributed").Client
    except ImportError:
        raise BristleError("cluster: needs Dask; run: pip install 'bristle[cluster]'") from None
    try:
        return client(address, timeout="10s", set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        line = " ".join(str(error).split()) or type(error).__name__
        raise BristleError(
            f"cluster {address}: {line}; give the address of a Dask scheduler, such as"
            " tcp://host:8786"
        ) from None
