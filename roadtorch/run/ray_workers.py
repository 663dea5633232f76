"""Workers on Ray: actors, on this machine or on a cluster."""

import logging
import os
import pickle
import re
import signal
import socket
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any

from roadtorch.base.compute import Threads
from roadtorch.base.errors import ConfigError
from roadtorch.run.workers import Workers, pickled

PATIENCE = 10.0  # seconds until a cluster has to answer; ours
STORE = 100 * 2**20  # bytes of a local cluster's object store; rows and weights are small

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",  # nothing is sent anywhere
    "RAY_BACKEND_LOG_LEVEL": "fatal",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}


class Actor:
    """What a worker of a cluster does: it unpickles the task once, and does item after item."""

    def __init__(self, task: bytes, threads: Threads) -> None:
        threads.set()
        self._task: Callable[[Any], Any] = pickle.loads(task)

    def work(self, item: bytes) -> bytes:
        """Return the pickled result of the task on a pickled item."""
        return pickled(self._task(pickle.loads(item)))


class RayPool:
    """Actors with one processor each, and with a GPU each where the device is one."""

    def __init__(self, device: str, is_cluster: bool, task: Callable[[Any], Any]) -> None:
        import ray
        from ray.exceptions import OutOfMemoryError, RayActorError

        self.crashes: tuple[type[Exception], ...] = (RayActorError, OutOfMemoryError)
        self._ray: Any = ray
        self._task = pickle.dumps(task, pickle.HIGHEST_PROTOCOL)
        self._threads = Threads.of_now()
        # OpenMP and BLAS read it before torch is loaded; Ray itself would say one thread. The
        # workers of a local cluster have the environment of this process.
        variables = {"OMP_NUM_THREADS": str(self._threads.torch)}
        options: dict[str, Any] = {"num_cpus": 1}
        options |= {"num_gpus": 1} if device.startswith("cuda") else {}
        options |= {"runtime_env": {"env_vars": variables}} if is_cluster else {}
        self._kind: Any = ray.remote(**options)(Actor)

    def start(self) -> Any:
        """As ``Pool.start``."""
        return self._kind.remote(self._task, self._threads)

    def submit(self, worker: Any, item: bytes) -> Future[bytes]:
        """As ``Pool.submit``."""
        return worker.work.remote(item).future()

    def end(self, workers: Sequence[Any]) -> None:
        """As ``Pool.end``."""
        for worker in workers:
            with suppress(Exception):  # it, or the whole cluster, has ended
                self._ray.kill(worker)


@contextmanager
def ray_workers(workers: int, address: str | None, device: str) -> Iterator[Workers]:
    """Give so many workers of a cluster, which is left, or ended where it is one of this machine.

    address: of the cluster; None for one of this machine. Raises ConfigError where Ray is not
    installed, or no cluster is at the address.
    """
    # What a local cluster's processes find in their environment.
    os.environ.update(QUIET, OMP_NUM_THREADS=str(Threads.of_now().torch))
    with TemporaryDirectory(prefix="rt-", ignore_cleanup_errors=True) as folder:
        ray = _imported()
        try:
            with _without_stderr(), _deaf_children():
                _join(ray, workers, address, folder)
            yield Workers(workers, partial(RayPool, device, address is not None))
        finally:
            ray.shutdown()


def _imported() -> Any:
    """Ray, told to show no bars, plans and advice; what goes wrong is raised."""
    try:
        # It reads deprecated settings of its own when it is imported.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import ray
    except ImportError:
        problem, hint = "Ray is not installed", "pip install 'roadtorch[ray]'"
        raise ConfigError("--engine ray", problem, hint) from None
    logging.getLogger("ray").setLevel(logging.CRITICAL)
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


def _join(ray: Any, workers: int, address: str | None, folder: str) -> None:
    quiet = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if address is None:
        ray.init(
            num_cpus=workers,
            include_dashboard=False,
            object_store_memory=STORE,
            _node_ip_address="127.0.0.1",
            _temp_dir=folder,
            **quiet,
        )
        return
    try:
        if at := re.fullmatch(r"(?:ray://)?([\w.-]+):(\d+)", address):
            # Where nobody listens Ray itself would try for minutes.
            socket.create_connection((at[1], int(at[2])), timeout=PATIENCE).close()
        ray.init(address=address, **quiet)
    except (OSError, ValueError, RuntimeError) as error:
        problem = f"no Ray cluster answers: {' '.join(str(error).split())[:200]}"
        hint = "give local, ray, or the address of a cluster, HOST:PORT"
        raise ConfigError(f"--engine {address}", problem, hint) from None
