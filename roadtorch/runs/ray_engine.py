"""The pictures of a run on Ray: a pool of actors, on this machine or on a compute."""

import logging
import os
import pickle
import re
import signal
import socket
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any, cast

from roadtorch.errors import ConfigError, InputError
from roadtorch.runs.index import Row
from roadtorch.runs.options import ComputeOptions
from roadtorch.runs.pictures import Engine, Job, Rows, Work
from roadtorch.runtime.threads import Threads

TOGETHER = 16  # jobs that a worker is given at once, and does anew when it dies; ours
MAX_BLOCKS = 10_000  # that the driver keeps an eye on; ours: Ray's own limit is memory
RETRIES = 3  # of jobs whose worker died, so that a picture that kills workers ends the run
PATIENCE = 10.0  # seconds until a cluster has to answer; ours
STORE = 100 * 2**20  # bytes of a local cluster's object store; rows and weights are small

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",  # nothing is sent anywhere
    "RAY_BACKEND_LOG_LEVEL": "fatal",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}


class Worker:
    """What an actor does: it unpickles the detector once, and works on one job after another."""

    def __init__(self, work: bytes, threads: Threads) -> None:
        threads.set()
        self._work: Work = pickle.loads(work)

    def __call__(self, item: Mapping[str, bytes]) -> dict[str, str]:
        """The row of a pickled job."""
        return asdict(self._work(pickle.loads(item["job"])))


@contextmanager
def ray_engine(compute: ComputeOptions) -> Iterator[Engine]:
    """The engine on a cluster, which is left, or ended where it is a local one, at the end.

    Raises ConfigError where Ray is not installed, or no cluster is at the address.
    """
    with (
        TemporaryDirectory(prefix="rt-", ignore_cleanup_errors=True) as folder,
        _environment({**QUIET, "OMP_NUM_THREADS": str(Threads.of_now().torch)}),
    ):
        ray = _imported()
        try:
            with _without_stderr(), _deaf_children():
                _join(ray, compute, folder)
            yield partial(_rows_of_actors, compute=compute)
        finally:
            ray.shutdown()


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """What this process, and a local cluster's, find in their environment during the block."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _imported() -> Any:
    """Ray, told to show no bars, plans and advice; what goes wrong is raised."""
    try:
        # It reads deprecated settings of its own when it is imported.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import ray
            import ray.data
    except ImportError:
        what, remedy = "Ray is not installed", "pip install 'roadtorch[ray]'"
        raise ConfigError("--engine ray", what, remedy) from None
    context = ray.data.DataContext.get_current()
    context.enable_progress_bars = False
    context.print_on_execution_start = False
    for name in ("ray", "ray.data"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    return ray


@contextmanager
def _without_stderr() -> Iterator[None]:
    """Send what libraries write to file number 2 nowhere: Ray announces its quiet there."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


@contextmanager
def _deaf_children() -> Iterator[None]:
    """Processes that are started in the block ignore SIGINT, which a terminal sends to all.

    A cluster that ends at once takes the driver with it, before it has saved what is finished.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _join(ray: Any, compute: ComputeOptions, folder: str) -> None:
    quiet = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if compute.address is None:
        ray.init(
            num_cpus=compute.workers,
            include_dashboard=False,
            object_store_memory=STORE,
            _node_ip_address="127.0.0.1",
            _temp_dir=folder,
            **quiet,
        )
        return
    try:
        if at := re.fullmatch(r"(?:ray://)?([\w.-]+):(\d+)", compute.address):
            # Where nobody listens Ray itself would try for minutes.
            socket.create_connection((at[1], int(at[2])), timeout=PATIENCE).close()
        ray.init(address=compute.address, **quiet)
    except (OSError, ValueError, RuntimeError) as problem:
        what = f"no Ray cluster answers: {' '.join(str(problem).split())[:200]}"
        remedy = "start one with 'ray start --head', or leave --address out"
        raise ConfigError(compute.address, what, remedy) from None


def _rows_of_actors(jobs: Sequence[Job], work: Work, compute: ComputeOptions) -> Rows:
    """The rows of all jobs, as they are finished.

    An actor that dies is started again, and gets its jobs anew. Threads are those of this
    process, whatever a worker's machine has: other numbers give other bytes.
    """
    if not jobs:
        return
    import ray
    from ray.data import ActorPoolStrategy
    from ray.exceptions import RayError

    threads = Threads.of_now()
    # OpenMP and BLAS read it before torch is loaded; Ray itself would say one thread. The workers
    # of a local cluster have the environment of this process.
    environment = {"env_vars": {"OMP_NUM_THREADS": str(threads.torch)}} if compute.address else None
    blocks = min(max(len(jobs) // TOGETHER, 4 * compute.workers), len(jobs), MAX_BLOCKS)
    items = [{"job": pickle.dumps(job)} for job in jobs]
    rows = ray.data.from_items(items, override_num_blocks=blocks).map(
        cast(Any, Worker),  # Ray makes one in each actor
        fn_constructor_args=(pickle.dumps(work), threads),
        compute=ActorPoolStrategy(size=compute.workers),
        num_cpus=1,
        num_gpus=1 if compute.device.startswith("cuda") else None,
        max_restarts=-1,
        max_task_retries=RETRIES,
        runtime_env=environment,
    )
    try:
        for row in rows.iter_rows():
            yield Row(**row)
    except RayError as problem:
        what = f"gave up: {type(problem).__name__}: {' '.join(str(problem).split())[:300]}"
        raise InputError("--engine ray", what, "run it again; finished pictures are kept") from None
