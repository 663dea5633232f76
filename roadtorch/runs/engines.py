"""With what, and where, the pictures of a run are worked on, as the options say."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import torch

from roadtorch.errors import ConfigError
from roadtorch.runs import batch, results
from roadtorch.runs.claim import claimed
from roadtorch.runs.coco import COCO, annotation_name, write_coco
from roadtorch.runs.index import INDEX, read_index
from roadtorch.runs.options import ComputeOptions, FrameSelection
from roadtorch.runs.remote import Fetched, Mirror, plan_remote
from roadtorch.runs.workers import rows_of_workers, usual_workers
from roadtorch.runtime.memory import keep_freed_memory
from roadtorch.runtime.threads import Threads
from roadtorch.sinks.remote_folder import RemoteFolder
from roadtorch.sources.addresses import is_url
from roadtorch.sources.frame import Selection, Source
from roadtorch.sources.live import Patience
from roadtorch.sources.open import SourceOptions, open_sources


def prepare(means: ComputeOptions) -> None:
    """Set threads and memory; ConfigError for a device that is not there."""
    Threads(means.threads, means.threads).set()
    keep_freed_memory()
    check_device(means.device)


def check_device(name: str) -> None:
    """Raises ConfigError for a device that torch does not know, or that this machine lacks."""
    try:
        kind = torch.device(name).type
    except RuntimeError:
        raise ConfigError(
            f"--device {name}", "is no device of torch", "give cpu, cuda or cuda:1"
        ) from None
    try:
        torch.zeros(1, device=name).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as problem:
        why = str(problem).splitlines()[0].rstrip(".")
        what = f"cannot be used: {why}"
        remedy = "leave --device out" if kind == "cuda" else "give cpu, cuda or cuda:1"
        raise ConfigError(f"--device {name}", what, remedy) from None


@contextmanager
def started(means: ComputeOptions, tasks: int) -> Iterator[batch.Engine | None]:
    """The engine that was asked for so many tasks, for the block; None: this process itself.

    Raises ConfigError where Ray is not there, or ``--address`` is given without it.
    """
    if means.engine == "local":
        if means.address is not None:
            what = "is for Ray alone"
            raise ConfigError("--address", what, "add --engine ray, or leave it out")
        workers = means.jobs or usual_workers(tasks)
        # A process that has used a GPU, or several threads of OpenMP, is not to be copied.
        is_plain = means.device == "cpu" and means.threads == 1
        yield partial(rows_of_workers, workers=workers) if is_plain and workers > 1 else None
        return
    from roadtorch.runs.ray_engine import Cluster, ray_engine

    gpu = means.device.startswith("cuda")
    with ray_engine(Cluster(means.address, means.workers, gpu)) as engine:
        yield engine


@dataclass(frozen=True)
class Plan:
    """The jobs of a run, the work that is done on each, and the folder of the results.

    remote: behind which URL that is, where it is behind one; ``work`` is made for it.
    """

    jobs: Sequence[batch.Task]
    work: batch.Work
    out: str
    remote: RemoteFolder | None = None

    @contextmanager
    def claimed(self) -> Iterator[Path]:
        """The folder in which index.csv and the like are written: of this run alone.

        It stands for the one behind the URL, where there is one; there nobody is kept out.
        """
        if self.remote is None:
            with claimed(Path(self.out)):
                yield Path(self.out)
            return
        with TemporaryDirectory(prefix="roadtorch-") as folder:
            Mirror(Path(folder), self.remote).fetch()
            yield Path(folder)

    def publish(self, path: Path) -> None:
        """Put a file of the claimed folder where it belongs, if that is elsewhere."""
        if self.remote is not None:
            self.remote.write(path.name, path.read_bytes())

    def assemble(self, place: Path, kinds: Sequence[str]) -> None:
        """Write what is made of the results of all pictures: coco.json, of their polygons."""
        if "polygons" not in kinds:
            return
        rows = read_index(place / INDEX).values()
        if self.remote is None:
            found = [row for row in rows if (place / annotation_name(row.file)).is_file()]
            write_coco(place / COCO, found, place.joinpath)
            return
        with TemporaryDirectory(prefix="roadtorch-") as scratch:
            write_coco(place / COCO, rows, partial(_fetched, Path(scratch), self.remote))
        self.publish(place / COCO)


def _fetched(scratch: Path, remote: RemoteFolder, name: str) -> Path:
    """A file of a remote folder as one of this machine, in place of the one fetched before."""
    path = scratch / "annotation.json"
    path.write_bytes(remote.read(name) or b"")
    return path


def selection(cut: FrameSelection) -> Selection:
    """Which frames and pictures the options choose."""
    return Selection(cut.every, cut.start, cut.end, cut.limit)


def footage_of(inputs: Sequence[str], out: str, cut: FrameSelection) -> list[Source]:
    """The sources of footage among the inputs, with what the options say of them.

    Raises ConfigError where their results would go behind a URL, and what ``open_sources`` raises.
    """
    if inputs and is_url(out):
        remedy = "give a folder of this machine, or pictures alone"
        raise ConfigError(f"--out {out}", "takes no results of footage", remedy)
    told = SourceOptions(Path(out), Patience(answer=cut.patience), cut.topic)
    return open_sources(inputs, selection(cut), told)


def plan_run(
    inputs: Sequence[str],
    out: str,
    kinds: Sequence[str],
    work: batch.Work,
    chosen: Selection,
) -> Plan:
    """The jobs for pictures and a folder that are on this machine or behind URLs.

    kinds: of results. Where one of them is behind a URL, all of them go that way. Raises what
    ``batch.plan`` and ``plan_remote`` raise.
    """
    suffixes = results.suffixes(kinds)
    if not any(map(is_url, [*inputs, out])):
        jobs = batch.plan(inputs, Path(out), suffixes, chosen, results.cue_suffixes(kinds))
        return Plan(jobs, work, out)
    url = out if is_url(out) else Path(out).absolute().as_uri()
    folder = RemoteFolder(url)
    jobs = chosen.of_pictures(plan_remote(inputs, folder, suffixes))
    return Plan(jobs, Fetched(work), out, folder)
