"""What bounds each stage of ``fusion``: the processor's rate, its memory, or neither of them.

Time is held against two floors (the roofline of Williams, Waterman and Patterson, "Roofline",
CACM 2009): the floating-point operations of a stage at the rate of a 1024² matrix product, and the
bytes that its operations take and give at the speed of a large copy, both measured in the same
run. A stage that takes more than twice the higher floor is bound by neither: its time goes
into starting many small operations.
"""

from functools import partial
from statistics import median
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves
from torch.utils.flop_counter import flop_registry

from roadtorch.detectors.catalogue import load_detector
from scripts.bench import STAGES, SUM, Round, run_rounds, time_call, time_stages
from scripts.bench_figures import Figure, Parts, figure
from scripts.bench_parts import SIDE, shown, street, threads_in_words

PART = "stages"
PRODUCT, COPY, FUSION = "product", "copy", "fusion, end to end"
LARGE = 2**25  # values that are copied: 128 MiB, far more than any cache holds
BOUND = 0.5
"""Share of a floor in the time from which a stage is said to be bound by it."""


class Counter(TorchDispatchMode):
    """Counts what torch does: kernels, floating-point operations, bytes in and out.

    A product or a convolution counts as torch.utils.flop_counter says, any other kernel one
    operation for each value that it takes or gives, whichever are more. A view costs nothing. What
    OpenCV, NumPy and SciPy do is not seen.
    """

    def __init__(self) -> None:
        super().__init__()
        self.kernels = self.operations = self.bytes = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run one operator and count it."""
        given = kwargs or {}
        if func.overloadpacket not in flop_registry:
            with self:  # in inference mode composed operators come whole: their parts are counted
                parts = func.decompose(*args, **given)
            if parts is not NotImplemented:
                return parts
        result = func(*args, **given)
        inputs = [one for one in tree_leaves((args, given)) if isinstance(one, Tensor)]
        outputs = [one for one in tree_leaves(result) if isinstance(one, Tensor)]
        places = {one.untyped_storage().data_ptr() for one in inputs}
        is_view = bool(outputs) and all(
            one.untyped_storage().data_ptr() in places for one in outputs
        )
        if is_view and not func._schema.is_mutable:
            return result
        self.kernels += 1
        self.bytes += sum(one.numel() * one.element_size() for one in [*inputs, *outputs])
        if func.overloadpacket in flop_registry:
            count = flop_registry[func.overloadpacket]
            self.operations += count(*args, **given, out_val=result)
        else:
            self.operations += max((one.numel() for one in [*inputs, *outputs]), default=0)
        return result


class Work(NamedTuple):
    """What torch does in a stage; bytes: taken and given by its kernels."""

    kernels: float
    operations: float
    bytes: float


def counted(image: Tensor) -> dict[str, Work]:
    """What torch does in each stage of one ``detect``: the stopwatch reads a counter as clock."""
    detect = load_detector("fusion").detect
    columns: list[Round] = []
    for quantity in Work._fields:
        with Counter() as counter:
            read = partial(getattr, counter, quantity)
            times = time_stages(detect, image, STAGES, lambda read=read: read() / 1000)
        columns.append(times)
    return {name: Work(*(column[name] for column in columns)) for name in STAGES}


def bound_by(ms: float, computing: float, moving: float) -> tuple[str, float]:
    """What bounds a stage of so many ms, and the share of the floor in its time.

    computing, moving: the ms that its operations and its bytes take at best.
    """
    floor = max(computing, moving) / ms
    if floor < BOUND:
        return "overhead", floor
    return ("compute" if computing > moving else "memory"), floor


def measure_stages(threads: int, rounds: int) -> list[Figure]:
    """Time, work and bound of each stage of ``fusion`` at 640×480, and of the whole."""
    words, image = threads_in_words(threads), street(640, 480)
    work, detect = counted(image), load_detector("fusion").detect
    square, long, to = torch.rand(SIDE, SIDE), torch.rand(LARGE), torch.empty(LARGE)
    contestants = [
        lambda: time_stages(detect, image),
        lambda: time_call(FUSION, lambda: detect(image)),
        lambda: time_call(PRODUCT, lambda: square @ square),
        lambda: time_call(COPY, lambda: to.copy_(long)),
    ]
    found: list[Round] = run_rounds(contestants, rounds, f"{PART}, {words}")
    times = {name: [one[name] for one in found] for name in found[0]}
    rate = 2 * SIDE**3 / median(times[PRODUCT])  # operations a ms
    speed = 2 * LARGE * long.element_size() / median(times[COPY])  # bytes a ms: read and written
    figures = []
    for name in STAGES:
        of = work[name]
        bound, floor = bound_by(median(times[name]), of.operations / rate, of.bytes / speed)
        figures += [
            figure(PART, name, "kernels", of.kernels, "kernels"),
            figure(PART, name, "Mflop", of.operations / 1e6, "Mflop"),
            figure(PART, name, "MB", of.bytes / 1e6, "MB"),
            shown(PART, name, f"ms, {words}", times[name]),
            figure(PART, name, f"floor, {words}", floor),
            figure(PART, name, f"bound by, {words}", bound),
        ]
    figures += [shown(PART, name, f"ms, {words}", times[name]) for name in (SUM, FUSION)]
    return [
        *figures,
        figure("machine", f"product of {SIDE}² matrices", f"GFLOP/s, {words}", rate / 1e6),
        figure("machine", "copy of 128 MiB", f"GB/s, {words}", speed / 1e6),
    ]


PARTS: Parts = {PART: measure_stages}
