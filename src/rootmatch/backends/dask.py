"""Several machines as one backend: blocks of hyper-edges go to the workers of a Dask scheduler.

What is kept depends neither on the blocks nor on the order in which they come back (`Strongest`), and a hyper-edge's
residual not on its block, so the tensor is the same to the last bit as that of one process, as long as the workers run
the same compiled code. On one machine they do: they find it on disk. Two machines that compile each for itself may
round differently, in the fourteenth digit: give them one folder in ``NUMBA_CACHE_DIR`` if that matters.

Work and results travel as pickles: who controls the scheduler, a worker or the connection can run anything; see
SECURITY.md.
"""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from importlib import import_module
from itertools import islice, takewhile
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rootmatch.backends import cpu
from rootmatch.backends.strongest import Block, Enumeration, Found, Progress, Strongest
from rootmatch.deadline import NEVER, Deadline
from rootmatch.errors import InputError, RootmatchError

CONNECT_SECONDS = 10.0
"""How long a scheduler may take to answer."""
IN_FLIGHT = 2
"""Pieces sent ahead to each thread of a cluster, so that none waits for the next."""
PIECE = 64_000_000
"""Maximum number of hyper-edges of an exhaustive build in a piece: about a second on a core."""
PIECES = 4
"""Minimum number of pieces per thread, if there is enough work."""

_one_at_a_time = Lock()
"""Each piece uses all threads that Numba has, whose simplest scheduler cannot be entered twice."""


def connect_client(scheduler: str) -> Any:
    """Client of a Dask scheduler that has workers; a context manager.

    Raises `InputError` if Dask is not installed, the scheduler does not answer or it has no workers.
    """
    try:
        # Untyped, and not installed everywhere.
        distributed: Any = import_module("distributed")
    except ImportError:
        raise InputError(
            "scheduler: Dask is not installed; pip install 'rootmatch[cluster]', or leave it out"
        ) from None
    if scheduler.startswith("tls:") and distributed.Security().get_connection_args("client").get("ssl_context") is None:
        raise InputError(
            f"scheduler: {scheduler} needs certificates; name them in Dask's configuration, distributed.comm.tls"
        )
    try:
        # a client that meets an unusable address waits for itself for 20 seconds when it is let go
        if not scheduler.startswith("inproc:"):
            _, port = distributed.comm.get_address_host_port(scheduler)
            if not 0 < int(port) < 2**16:
                raise ValueError(f"port {port}")
        client = distributed.Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"scheduler: {scheduler} does not answer ({error}); start one with `dask scheduler`") from None
    except (TypeError, RuntimeError, AssertionError) as error:
        raise InputError(f"scheduler: {scheduler} cannot be used ({error}); give tcp://HOST:PORT") from None
    if not client.nthreads():
        client.close()
        raise InputError(f"scheduler: {scheduler} has no workers; start some with `dask worker {scheduler}`")
    return client


def _strongest(work: bytes, first: int, last: int, gate: float, limit: int) -> Found:
    """Piece of an exhaustive build, on a worker."""
    with _one_at_a_time:
        (enumeration,) = _read(work)
        return cpu.strongest(enumeration, first, last, gate, limit)


def _residuals(work: bytes, block: Block) -> NDArray[np.float64]:
    """Residuals of given hyper-edges, on a worker."""
    with _one_at_a_time:
        tables, kind = _read(work)
        return cpu.residuals(tables, kind, *block)


_latest: tuple[bytes, tuple[Any, ...]] = (b"", ())


def _read(work: bytes) -> tuple[Any, ...]:
    """What was sent, read once by each worker; a problem whose kernels are made when it is used makes them first."""
    global _latest
    if _latest[0] != work:
        prepare, content = pickle.loads(work)
        prepare()
        _latest = work, pickle.loads(content)
    return _latest[1]


class Cluster:
    """The workers of a Dask scheduler as a backend.

    ``scheduler``: address, ``tcp://host:port``; its workers need this package in this version. ``prepare``: makes the
    tables, as `Problem.prepare`: each worker calls it once, and then knows the problem's kernels.
    """

    def __init__(self, scheduler: str, prepare: Callable[[], Any]) -> None:
        self.scheduler = scheduler
        self.prepare = prepare

    def _send_content(self, client: Any, *content: Any) -> Any:
        """Content that all pieces share, sent once to each worker."""
        return client.scatter(pickle.dumps((self.prepare, pickle.dumps(content))), broadcast=True, hash=False)

    def strongest(
        self,
        work: Enumeration,
        first: int,
        last: int,
        gate: float,
        limit: int,
        progress: Progress | None = None,
        deadline: Deadline = NEVER,
    ) -> Found:
        """See `Backend.strongest`; pieces that are on their way at the deadline are waited for."""
        kept = Strongest(limit, gate)
        evaluated = done = 0
        # compiled here first: workers on this machine then find the very same code on disk
        cpu.strongest(work, first, min(first + 1, last), gate, 1)
        with connect_client(self.scheduler) as client:
            threads = sum(client.nthreads().values())
            size = max(1, min(PIECE // work.per_slab, -(-(last - first) // (PIECES * threads))))
            sent = self._send_content(client, work)

            # the gate sinks as the strongest come in, and later pieces send back less
            def submit(ranks: range) -> Any:
                sought = ranks.start, ranks.stop, kept.gate, limit
                return client.submit(_strongest, sent, *sought, pure=False)

            starts = takewhile(lambda start: not deadline.passed(), range(first, last, size))
            pieces = (range(start, min(start + size, last)) for start in starts)
            for ranks, found in results_in_order(submit, pieces, IN_FLIGHT * threads, "a piece"):
                kept.add(found.codes, found.residuals)
                evaluated += found.evaluated
                done += len(ranks)
                if progress is not None:
                    progress(done, last - first)
        return Found(*kept.settle(), evaluated)

    def evaluated(self, tables: Any, kind: Any, blocks: Iterable[Block]) -> Iterator[tuple[Block, NDArray[np.float64]]]:
        """See `Backend.evaluated`."""
        with connect_client(self.scheduler) as client:
            threads = sum(client.nthreads().values())
            sent = self._send_content(client, tables, kind)
            pieces = self._compile_first(tables, kind, blocks)
            # not pure: Dask would otherwise look the result up by a hash of its input
            submit = partial(client.submit, _residuals, sent, pure=False)
            yield from results_in_order(submit, pieces, IN_FLIGHT * threads, "a piece")

    @staticmethod
    def _compile_first(tables: Any, kind: Any, blocks: Iterable[Block]) -> Iterator[Block]:
        """The blocks, once what evaluates them is compiled here, for workers on this machine to find it on disk."""
        for number, (source, target) in enumerate(blocks):
            if number == 0:
                cpu.residuals(tables, kind, source[:1], target[:1])
            yield source, target


def results_in_order(
    submit: Callable[[Any], Any], pieces: Iterator[Any], ahead: int, failed: str = ""
) -> Iterator[tuple[Any, Any]]:
    """Pieces and their results, in order, with so many of them sent ahead; ``failed`` begins the text of an error."""
    waiting = deque((piece, submit(piece)) for piece in islice(pieces, ahead))
    while waiting:
        piece, future = waiting.popleft()
        try:
            result = future.result()
        except RootmatchError:
            raise
        except Exception as error:
            if not failed:
                raise
            raise RootmatchError(f"scheduler: {failed} failed on a worker: {error!r}") from error
        yield piece, result
        waiting.extend((piece, submit(piece)) for piece in islice(pieces, 1))
