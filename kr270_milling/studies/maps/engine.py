"""Many rows in chunks: each chunk is a separate Parquet file, so that a study continues after a stop.

An executor of ``concurrent.futures`` makes the chunks: as many processes as cores, or the workers of a Dask scheduler
whose address is given. A chunk depends on nothing but its number, so the rows are the same bit for bit whatever the
number of workers.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import itertools
import json
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from multiprocessing import connection
from pathlib import Path

from kr270_milling.base.arguments import one_thread_each
from kr270_milling.base.errors import InputError, ModelError
from kr270_milling.base.parameter_file import read_tree

AHEAD = 3  #: chunks a worker that are under way at once: none idles, and memory stays bounded
ANSWER = 10.0  #: [s] for a scheduler to answer
METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"


class StudyRows:
    """The rows of a study; a worker makes any chunk of them from its number alone."""

    chunk: int  #: rows a file

    def __len__(self) -> int:
        raise NotImplementedError

    def columns(self, first: int, last: int) -> dict:
        """The columns of the rows of the numbers first to last."""
        raise NotImplementedError

    @property
    def chunks(self) -> int:
        """Number of files."""
        return -(-len(self) // self.chunk)

    def __call__(self, number: int) -> bytes:
        """The Parquet bytes of one chunk."""
        import pyarrow as pa
        from pyarrow import parquet

        first = number * self.chunk
        sink = io.BytesIO()
        table = pa.table(self.columns(first, min(first + self.chunk, len(self))))
        parquet.write_table(table, sink, compression="zstd")
        return sink.getvalue()


class Study:
    """A folder of chunks. Raises InputError where it holds those of another study."""

    def __init__(self, folder, plan: dict):
        self.folder, self.plan = Path(folder), json.loads(json.dumps(plan))
        self.folder.mkdir(parents=True, exist_ok=True)
        plan_name = "_study.json"  # Arrow leaves out names that begin with "_" where it reads the folder
        place, before = self.folder / plan_name, self.folder / plan_name[1:]
        if before.exists():  # of version 0.2
            before.replace(place)
        if place.exists():
            with contextlib.suppress(ValueError):
                if json.loads(place.read_text(encoding="utf-8")) == self.plan:
                    return
            raise InputError(self.folder, "holds the rows of another study: choose another --out")
        _write_whole(place, json.dumps(self.plan, indent=1).encode())

    def chunk(self, number: int) -> Path:
        """Return the file of a chunk, which may not exist yet."""
        return self.folder / f"rows-{number:06d}.parquet"

    def missing(self, count: int) -> list[int]:
        """Return the numbers of the missing chunks."""
        return [number for number in range(count) if not self.chunk(number).exists()]

    def tables(self, count: int, columns=None) -> Iterator:
        """The chunks as Arrow tables, one after the other, so that memory holds one."""
        from pyarrow import parquet

        for number in range(count):
            yield parquet.read_table(self.chunk(number), columns=columns)


def content(path, program: str) -> str:
    """Return a hash of a parameter file and of the hash of its program: rows of another cell have another hash."""
    tree = json.dumps(read_tree(path), sort_keys=True, default=str)
    return hashlib.sha256(f"{tree}{program}".encode()).hexdigest()


def _write_whole(path: Path, data: bytes) -> None:
    draft = path.with_suffix(".part")
    draft.write_bytes(data)
    draft.replace(path)


def run_chunks(
    study: Study,
    count: int,
    rows_of: Callable[[int], bytes],
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> float:
    """Make the missing ones of ``count`` chunks; rows_of(number): the bytes of a Parquet file. Returns seconds.

    A Dask scheduler lets another worker make the chunk of a killed worker again; a killed driver loses the chunks under
    way. Raises ModelError where the scheduler cannot be reached or has no worker, and where the workers stop.
    """
    missing, start = study.missing(count), time.monotonic()
    first = count - len(missing)
    if scheduler is None:
        missing = missing[_alone(study, missing, rows_of, lambda n: progress and progress(first + n, count)) :]
    if not missing:
        return time.monotonic() - start
    complete = count - len(missing)
    try:
        with _executor(scheduler, rows_of) as (executor, workers):
            for number, data in _made(executor, workers, missing, rows_of):
                _write_whole(study.chunk(number), data)
                complete += 1
                if progress is not None:
                    progress(complete, count)
    except (BrokenExecutor, CancelledError, OSError, TimeoutError) as error:
        text = f"the workers have stopped, or lack this package ({error}); the same command continues the study"
        raise ModelError(text) from None
    return time.monotonic() - start


def _alone(study: Study, missing: list[int], rows_of: Callable[[int], bytes], report: Callable[[int], object]) -> int:
    """Make chunks here as long as the rest takes less than the start of workers; returns how many were made."""
    alone = 4.0  # [s] of work before local workers have imported the package
    compiles = 60.0  # [s] that a first chunk may take because it compiles; assumed, for a busy machine
    for k, number in enumerate(missing):
        start = time.monotonic()
        _write_whole(study.chunk(number), rows_of(number))
        report(k + 1)
        took = time.monotonic() - start
        # the first chunk may compile, so that a short one has a second try
        if took * (len(missing) - k - 1) > alone and (k > 0 or took > compiles):
            return k + 1
    return len(missing)


def _made(
    executor: Executor, workers: int, missing: list[int], rows_of: Callable[[int], bytes]
) -> Iterator[tuple[int, bytes]]:
    """Yield number and bytes of each finished chunk; at most AHEAD chunks a worker are under way."""
    waiting = iter(missing)
    numbers: dict[Future, int] = {}
    while True:
        for number in itertools.islice(waiting, AHEAD * workers - len(numbers)):
            numbers[executor.submit(rows_of, number)] = number
        if not numbers:
            return
        for future in wait(numbers, return_when=FIRST_COMPLETED).done:
            yield numbers.pop(future), future.result()


@contextlib.contextmanager
def _executor(scheduler: str | None, rows_of: Callable[[int], bytes]) -> Iterator[tuple[Executor, int]]:
    """Yield an executor and the number of its workers: local processes, or those of a Dask scheduler."""
    if scheduler is None:
        with _processes(rows_of) as pool:
            yield pool, os.cpu_count() or 1
        return
    import dask
    from dask.distributed import Client

    patience = 30.0  # [s] for a first worker
    quiet = {
        "distributed.logging.distributed": "critical",  # a worker that ends may miss a heartbeat
        "distributed.admin.log-format": "",
        "distributed.scheduler.allowed-failures": 3,
        # each of its entries holds a task with the cell: 1000 grew by 90 MB
        "distributed.admin.low-level-log-length": 10,
    }
    with dask.config.set(quiet):
        try:
            client = Client(scheduler, timeout=ANSWER)
        except (OSError, ValueError) as error:
            raise ModelError(f"the scheduler {scheduler} does not answer: {error}") from None
        with client:
            client.wait_for_workers(1, timeout=patience)
            yield client.get_executor(pure=False), max(1, sum(client.nthreads().values()))


@contextlib.contextmanager
def _processes(rows_of: Callable[[int], bytes]) -> Iterator[Executor]:
    """Yield a pool of local processes, which are forked from one process that has imported what they need.

    They inherit that SIGINT is blocked: Ctrl-C reaches this process alone, which ends the workers.
    """
    context = multiprocessing.get_context(METHOD)
    one_thread_each(os.environ)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        if METHOD == "forkserver":
            from multiprocessing import forkserver, resource_tracker

            context.set_forkserver_preload([type(rows_of).__module__, "pandas", "pyarrow.parquet"])
            resource_tracker.ensure_running()  # its start unblocks SIGINT
            signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
            forkserver.ensure_running()
        pool = ProcessPoolExecutor(os.cpu_count() or 1, context, _end_with_parent)
        pool.submit(os.getpid)  # starts the processes
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _end_with_parent() -> None:
    """End this worker when the process of the study is killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        connection.wait([sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
