"""Workers as Ray actors, on this machine or on a cluster."""

import logging
import os
import pickle
import re
import socket
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any

from roadtorch.base.compute import Threads
from roadtorch.base.errors import ConfigError
from roadtorch.base.signals import block_sigint_in_children
from roadtorch.run.workers import TaskFunction, WorkerCrashError, Workers, pickle_value

CONNECT_TIMEOUT = 10.0  # seconds to wait for a cluster; ours
OBJECT_STORE_BYTES = 100 * 2**20  # of a local cluster; rows and weights are small

QUIET_VARIABLES = {
    "RAY_USAGE_STATS_ENABLED": "0",  # nothing is sent anywhere
    "RAY_BACKEND_LOG_LEVEL": "fatal",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}


class Actor:
    """A worker of a cluster: unpickles the task once, then processes one item after the other."""

    def __init__(self, task: bytes, threads: Threads) -> None:
        threads.set()
        self._task: TaskFunction = pickle.loads(task)

    def work(self, item: bytes) -> bytes:
        """Apply the task to a pickled item and return the pickled result."""
        return pickle_value(self._task(pickle.loads(item)))[0]


class RayWorker:
    """An actor with one CPU, and one GPU where the device is CUDA."""

    def __init__(self, ray: Any, options: dict[str, object], task: TaskFunction) -> None:
        self._ray, self.result = ray, None
        data = pickle.dumps(task, pickle.HIGHEST_PROTOCOL)
        self._actor = ray.remote(**options)(Actor).remote(data, Threads.current())

    def send(self, item: object) -> None:
        """Let the actor process an item."""
        self.result = self._actor.work.remote(pickle_value(item)[0])

    def receive(self) -> Any:
        """Return the result of the item; WorkerCrashError if the actor died."""
        from ray.exceptions import OutOfMemoryError, RayActorError

        try:
            return pickle.loads(self._ray.get(self.result))
        except (RayActorError, OutOfMemoryError):
            raise WorkerCrashError from None

    def stop(self) -> None:
        """Kill the actor."""
        with suppress(Exception):  # the actor or the whole cluster has already ended
            self._ray.kill(self._actor)


def _wait(ray: Any, workers: Iterable[RayWorker], timeout: float | None) -> list[RayWorker]:
    by_result = {worker.result: worker for worker in workers}
    return [by_result[result] for result in ray.wait([*by_result], timeout=timeout)[0]]


@contextmanager
def ray_workers(workers: int, address: str | None, device: str) -> Iterator[Workers]:
    """Connect to a Ray cluster for the block; a local one is started, and ended after it.

    address: of the cluster; None starts one on this machine. Raises ConfigError where Ray is not
    installed, or no cluster answers.
    """
    # OpenMP and BLAS read the number before torch is loaded; Ray's default is one thread. Workers
    # of a local cluster inherit the environment of this process.
    threads = {"OMP_NUM_THREADS": str(Threads.current().torch)}
    os.environ.update(QUIET_VARIABLES, **threads)
    options: dict[str, object] = {"num_cpus": 1}
    options |= {"num_gpus": 1} if device.startswith("cuda") else {}
    options |= {"runtime_env": {"env_vars": threads}} if address is not None else {}
    with TemporaryDirectory(prefix="rt-", ignore_cleanup_errors=True) as folder:
        ray = _import_ray()
        try:
            # A cluster that ended at once would end this process before it has saved results.
            with _silence_stderr(), block_sigint_in_children():
                _connect(ray, workers, address, folder)
            yield Workers(workers, partial(RayWorker, ray, options), partial(_wait, ray))
        finally:
            ray.shutdown()


def _import_ray() -> Any:
    """Import Ray with its warnings and log messages silenced; errors are raised."""
    try:
        # Importing Ray warns of deprecated settings that it reads itself.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import ray
    except ImportError:
        problem, hint = "Ray is not installed", "pip install 'roadtorch[ray]'"
        raise ConfigError("--engine ray", problem, hint) from None
    logging.getLogger("ray").setLevel(logging.CRITICAL)
    return ray


@contextmanager
def _silence_stderr() -> Iterator[None]:
    """Redirect file descriptor 2 to /dev/null: Ray's native code prints to it while starting."""
    stderr, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 2)
    try:
        yield
    finally:
        os.dup2(stderr, 2)
        os.close(stderr)
        os.close(null)


def _connect(ray: Any, workers: int, address: str | None, folder: str) -> None:
    quiet = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if address is None:
        ray.init(
            num_cpus=workers,
            include_dashboard=False,
            object_store_memory=OBJECT_STORE_BYTES,
            _node_ip_address="127.0.0.1",
            _temp_dir=folder,
            **quiet,
        )
        return
    try:
        if match := re.fullmatch(r"(?:ray://)?([\w.-]+):(\d+)", address):
            # Where nothing listens, Ray itself would retry for minutes.
            socket.create_connection((match[1], int(match[2])), timeout=CONNECT_TIMEOUT).close()
        ray.init(address=address, **quiet)
    except (OSError, ValueError, RuntimeError) as error:
        problem = f"no Ray cluster answers: {' '.join(str(error).split())[:200]}"
        hint = "give local, ray, or the address of a cluster, HOST:PORT"
        raise ConfigError(f"--engine {address}", problem, hint) from None
