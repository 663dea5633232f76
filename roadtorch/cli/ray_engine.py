"""The pictures of a run on Ray: a pool of actors, on this machine or on a cluster."""

import logging
import os
import pickle
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any

from roadtorch.cli.batch import Engine, Rows, Task, Work
from roadtorch.cli.index import Row
from roadtorch.cli.threads import Threads
from roadtorch.errors import ConfigError, InputError

TOGETHER = 16  # jobs that a worker is given at once, and does anew when it dies; ours
MOST_BLOCKS = 10_000  # that the driver keeps an eye on; ours: Ray's own limit is memory
RETRIES = 3  # of jobs whose worker died, so that a picture that kills workers ends the run
STORE = 100 * 2**20  # bytes of a local cluster's object store; rows and weights are small

QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",  # nothing is sent anywhere
    "RAY_BACKEND_LOG_LEVEL": "fatal",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
}


@dataclass(frozen=True)
class Cluster:
    """Where actors run. address: of a cluster; None: one of this machine, for this run alone.

    workers: actors, each with a processor, and one of the cluster's GPUs where ``gpu`` says so.
    """

    address: str | None
    workers: int
    gpu: bool = False


class Worker:
    """What an actor does: it unpickles the detector once, and works on one job after another."""

    def __init__(self, work: bytes, threads: Threads) -> None:
        threads.set()
        self._work: Work = pickle.loads(work)

    def __call__(self, item: Mapping[str, bytes]) -> dict[str, str]:
        """The row of a pickled job."""
        return asdict(self._work(pickle.loads(item["job"])))


@contextmanager
def ray_engine(cluster: Cluster) -> Iterator[Engine]:
    """The engine on a cluster, which is left, or ended where it is a local one, at the end.

    Raises ConfigError where Ray is not installed, or no cluster is at the address.
    """
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    try:
        # Ray reads deprecated settings of its own when it is imported.
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import ray
            import ray.data
    except ImportError:
        raise ConfigError(
            "--engine ray", "Ray is not installed", "pip install 'roadtorch[ray]'"
        ) from None
    _silence(ray)
    with TemporaryDirectory(prefix="rt-", ignore_cleanup_errors=True) as folder:
        try:
            _join(ray, cluster, folder)
            yield partial(_rows_of_actors, cluster=cluster)
        finally:
            ray.shutdown()


def _silence(ray: Any) -> None:
    """No bars, no plans, no advice; what goes wrong is raised."""
    context = ray.data.DataContext.get_current()
    context.enable_progress_bars = False
    context.print_on_execution_start = False
    for name in ("ray", "ray.data"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


def _join(ray: Any, cluster: Cluster, folder: str) -> None:
    quiet = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if cluster.address is None:
        ray.init(
            num_cpus=cluster.workers,
            include_dashboard=False,
            object_store_memory=STORE,
            _node_ip_address="127.0.0.1",
            _temp_dir=folder,
            **quiet,
        )
        return
    try:
        ray.init(address=cluster.address, **quiet)
    except (ConnectionError, ValueError, RuntimeError) as problem:
        what = f"no Ray cluster answers: {' '.join(str(problem).split())[:200]}"
        remedy = "start one with 'ray start --head', or leave --address out"
        raise ConfigError(cluster.address, what, remedy) from None


def _rows_of_actors(jobs: Sequence[Task], work: Work, cluster: Cluster) -> Rows:
    """The rows of all jobs, as they are finished.

    An actor that dies is started again, and gets its jobs anew. Threads are those of this
    process, whatever a worker's machine has: other numbers give other bytes.
    """
    if not jobs:
        return
    import ray
    from ray.data import ActorPoolStrategy
    from ray.exceptions import RayError

    blocks = min(max(len(jobs) // TOGETHER, 4 * cluster.workers), len(jobs), MOST_BLOCKS)
    items = [{"job": pickle.dumps(job)} for job in jobs]
    threads = Threads.of_now()
    rows = ray.data.from_items(items, override_num_blocks=blocks).map(
        Worker,
        fn_constructor_args=(pickle.dumps(work), threads),
        compute=ActorPoolStrategy(size=cluster.workers),
        num_cpus=1,
        num_gpus=1 if cluster.gpu else None,
        max_restarts=-1,
        max_task_retries=RETRIES,
        runtime_env={"env_vars": _worker_environment(threads)},
    )
    try:
        for row in rows.iter_rows():
            yield Row(**row)
    except RayError as problem:
        what = f"gave up: {type(problem).__name__}: {' '.join(str(problem).split())[:300]}"
        raise InputError("--engine ray", what, "run it again; finished pictures are kept") from None


def _worker_environment(threads: Threads) -> dict[str, str]:
    """What OpenMP and BLAS read before torch is loaded; Ray itself would say one thread."""
    return {"OMP_NUM_THREADS": str(threads.torch), "OMP_WAIT_POLICY": "passive"}
