"""The measures of layout labels: recalls of the classes under each reading of void, confusions."""

from collections.abc import Callable

from torch import Tensor

from roadtorch.evaluation import metrics
from roadtorch.evaluation.measure import Formula, Measure, Place
from roadtorch.evaluation.parts import Part
from roadtorch.layout.classes import NAMES

Confusion = Callable[[Part], Tensor | None]
"""Which confusion of a part is meant; None where it has none."""


def _layout(part: Part) -> Tensor | None:
    return part.layout


def _labels(part: Part) -> Tensor | None:
    return part.labels


def _void_as_vertical(of: Confusion) -> Confusion:
    """The same under P2's literal reading of void."""

    def read(part: Part) -> Tensor | None:
        confusion = of(part)
        return None if confusion is None else metrics.void_as_vertical(confusion)

    return read


def _of(confusion: Confusion, figure: Callable[[Tensor], Tensor]) -> Formula:
    def formula(part: Part) -> Tensor | None:
        found = confusion(part)
        return None if found is None else figure(found)

    return formula


def _recall_of(place: int) -> Callable[[Tensor], Tensor]:
    return lambda confusion: metrics.class_recalls(confusion)[..., place]


def _share_of(truth: int, decided: int) -> Callable[[Tensor], Tensor]:
    return lambda confusion: metrics.normalised_confusion(confusion)[..., truth, decided]


def _recalls(
    under: str, of: Confusion, words: str = "", shown: tuple[Place, ...] = ()
) -> tuple[Measure, ...]:
    """The recall of each class."""
    return tuple(
        Measure(
            f"{under}/{name}",
            name,
            f"Share of {name} that is found{words}.",
            _of(of, _recall_of(place)),
            shown=shown,
        )
        for place, name in enumerate(NAMES)
    )


BOTH: tuple[Place, ...] = ("screen layout", "layout")
VOID = ", void counted as vertical"
LABELLED = ", where the labeller does not abstain"

LAYOUT_MEAN = Measure(
    "layout/mean",
    "mean",
    "Mean of the three.",
    _of(_layout, metrics.mean_class_recall),
    interval=True,
    shown=(*BOTH, "pairs"),
)

LAYOUT = (
    *_recalls("layout", _layout, shown=BOTH),
    LAYOUT_MEAN,
    Measure(
        "layout/accuracy",
        "accuracy",
        "Share of all pixels that are right.",
        _of(_layout, metrics.layout_accuracy),
        shown=("layout",),
    ),
    *(
        Measure(
            f"layout/confusion/{truth}/{decided}",
            f"{truth} as\n{decided}",
            f"Share of {truth} that is decided to be {decided}.",
            _of(_layout, _share_of(row, column)),
            better=None,
        )
        for row, truth in enumerate(NAMES)
        for column, decided in enumerate(NAMES)
    ),
    *_recalls("layout/void_as_vertical", _void_as_vertical(_layout), VOID),
    Measure(
        "layout/void_as_vertical/mean",
        "mean, void\nvertical",
        f"Mean of the three{VOID}.",
        _of(_void_as_vertical(_layout), metrics.mean_class_recall),
        shown=BOTH,
    ),
    *_recalls("layout/labelled", _labels, LABELLED),
    Measure(
        "layout/labelled/mean",
        "mean,\nlabelled",
        f"Mean of the three{LABELLED}.",
        _of(_labels, metrics.mean_class_recall),
        shown=BOTH,
    ),
    *_recalls("layout/labelled/void_as_vertical", _void_as_vertical(_labels), LABELLED + VOID),
    Measure(
        "layout/labelled/void_as_vertical/mean",
        "mean,\nlabelled, void\nvertical",
        f"Mean of the three{LABELLED}{VOID}.",
        _of(_void_as_vertical(_labels), metrics.mean_class_recall),
    ),
    Measure(
        "layout/labelled_share",
        "labelled\nshare",
        "Share of pixels with a label.",
        _of(_labels, metrics.labelled_share),
        shown=BOTH,
    ),
)
