"""The tables of a report: which measures they show, what each means, and the cells as text."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from roadtorch.evaluation.metrics import LAYOUT_CLASSES
from roadtorch.report.page.svg import Series, bounds, is_floor, number, ranked_names

NONE = "–"

MOST_COLUMNS = 8  # drives with a column of their own

MOST_ROWS = 40  # of tables by drive and of layouts; more detectors: those in the charts

Figures = Mapping[str, Any]

Best = Callable[[Iterable[float]], float]


def share(value: float | None) -> str:
    """Three decimals."""
    return NONE if value is None else f"{value:.3f}"


def signed(value: float | None) -> str:
    """Three decimals with a sign."""
    return NONE if value is None else f"{value:+.3f}".replace("-", "\N{MINUS SIGN}")


def _tenths(value: float | None) -> str:
    return NONE if value is None else f"{value:.1f}"


def _whole(value: float | None) -> str:
    return NONE if value is None else f"{value:.0f}"


# --- measures ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Measure:
    """A figure of metrics.json: where it is, what it is called, how it is read."""

    name: str
    keys: tuple[str, ...]  # way from a detector's figures down to the number
    meaning: str
    best: Best | None = max
    form: Callable[[float | None], str] = share

    def of(self, figures: Figures) -> float | None:
        """The number, or None where it is missing or undefined."""
        return number(_follow(figures, self.keys))

    def is_in(self, figures: Figures) -> bool:
        """Whether the figures know the measure, defined or not."""
        return self.keys[-1] in (_follow(figures, self.keys[:-1]) or {})


def _follow(figures: Any, keys: Sequence[str]) -> Any:
    for key in keys:
        figures = figures.get(key) if isinstance(figures, Mapping) else None
    return figures


MAXF = Measure(
    "MaxF",
    ("maxf",),
    "Highest F of all thresholds, on pooled pixels. F is the harmonic mean of precision and "
    "recall. The threshold is picked on the labels that score it.",
)

SCORES = (
    Measure(
        "AUC",
        ("auc_pooled",),
        "Share of pairs (road pixel, other pixel) that the likelihood puts in the right order.",
    ),
    Measure("AP", ("ap",), "Best precision at recall 0, 0.1, … 1 or above, averaged (KITTI)."),
    Measure("IoU", ("iou",), "Overlap of decided and true road, at the chosen threshold."),
    Measure("EER", ("eer",), "Error rate where false positives and misses are as many.", min),
    Measure("Brier", ("brier",), "Mean squared distance of likelihood and truth.", min),
    Measure("ms", ("ms_per_image",), "Median time of one picture, detector alone.", None, _tenths),
)

RANKING = (
    Measure("AUC\n/image", ("auc_mean",), "Mean of the AUCs of single pictures."),
    Measure(
        "ECE",
        ("ece",),
        "Mean distance of the likelihood and the share of road that really has it.",
        min,
    ),
)

CHOSEN = (
    Measure(
        "threshold",
        ("threshold",),
        "Likelihood from which a pixel is decided to be road.",
        None,
    ),
    Measure("F", ("f",), "F at the chosen threshold."),
    Measure("precision", ("precision",), "Share of true road in what is decided to be road."),
    Measure("recall", ("recall",), "Share of the true road that is found."),
    Measure("IoU\nof mask", ("iou_mask",), "Overlap of the detector's own mask, as it ships."),
)

WORKING = (
    Measure("PRE", ("working_point", "precision"), "Precision where F is highest (KITTI)."),
    Measure("REC", ("working_point", "recall"), "Recall there."),
    Measure("FPR", ("working_point", "fpr"), "False positive rate there.", min),
    Measure("FNR", ("working_point", "fnr"), "False negative rate there.", min),
)

BORDER = "F of borders: decided and true ones count as met within this share of the diagonal."


def border_measures(parts: Iterable[Figures]) -> list[Measure]:
    """A measure for each tolerance of the border's F, strictest first."""
    found = {key for figures in parts for key in figures.get("boundary_f") or {}}
    order = sorted(found, key=lambda key: (number(_as_float(key)) or 0.0, key))
    return [
        Measure(f"border F\n{100 * (_as_float(key) or 0):g} %", ("boundary_f", key), BORDER)
        for key in order
    ]


def _as_float(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def measures_shown(detectors: Mapping[str, Figures]) -> list[Measure]:
    """The measures that the tables of these detectors have, for the key to them."""
    every = list(detectors.values())
    every += [part for figures in every for part in figures.get("groups", {}).values()]
    borders = [Measure("border F", one.keys, one.meaning) for one in border_measures(every)[:1]]
    known = (MAXF, *SCORES, *RANKING, *CHOSEN, *borders, *WORKING)
    return [one for one in known if any(one.is_in(figures) for figures in every)]


# --- tables -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """A cell: its text, the number to sort by, whether it stands out, and a note."""

    text: str
    value: float | None = None
    strong: bool = False
    note: str = ""  # small, below


@dataclass(frozen=True)
class Table:
    """Columns under headers, each header with a line that explains it; rows by name."""

    names: Sequence[str]
    headers: list[tuple[str, str]] = field(default_factory=list)
    columns: list[list[Cell]] = field(default_factory=list)

    def add(self, header: str, hint: str, cells: Sequence[Cell]) -> None:
        """One more column."""
        self.headers.append((header, hint))
        self.columns.append(list(cells))

    def measure(self, one: Measure, parts: Sequence[Figures], header: str = "") -> None:
        """A column of one measure, the best in it strong; none if nobody has the measure."""
        if any(one.is_in(figures) for figures in parts):
            values = [one.of(figures) for figures in parts]
            known = [value for value in values if value is not None]
            best = one.best(known) if one.best and len(known) > 1 else None
            cells = [Cell(one.form(value), value, value == best is not None) for value in values]
            self.add(header or one.name, one.meaning, cells)

    def rows(self) -> list[tuple[str, bool, list[Cell]]]:
        """(name, whether a floor, cells) of each row."""
        cells = zip(*self.columns, strict=True) if self.columns else ([] for _ in self.names)
        return [
            (name, is_floor(name), list(row)) for name, row in zip(self.names, cells, strict=True)
        ]


def drive_names(detectors: Mapping[str, Figures]) -> list[str]:
    """The drives that any detector has figures of."""
    return sorted({drive for one in detectors.values() for drive in one.get("groups", {})})


def all_tables(document: Mapping[str, Any], series: Sequence[Series]) -> dict[str, Any]:
    """Scores and further measures of all detectors, differences, and the tables by drive."""
    detectors = document["detectors"]
    names = ranked_names(detectors)
    shown = names if len(names) <= MOST_ROWS else [one.name for one in series]
    drives = {
        drive: {name: detectors[name].get("groups", {}).get(drive, {}) for name in shown}
        for drive in drive_names(detectors)
    }
    if any("pooled" in detectors[name] for name in shown):
        drives["all drives, pixels pooled"] = {
            name: detectors[name].get("pooled", {}) for name in shown
        }
    return {
        "scores": score_table(detectors, names),
        "further": further_table(detectors, names),
        "paired": paired_table(document.get("paired") or {}, names),
        "drives": {drive: part_table(part, shown) for drive, part in drives.items()},
        "shown": len(shown),
    }


def score_table(detectors: Mapping[str, Figures], names: Sequence[str]) -> Table:
    """MaxF by drive and mean, its interval, its distance to the floor, and the other scores."""
    parts, table = [detectors[name] for name in names], Table(names)
    drives = drive_names(detectors)
    for drive in drives if len(drives) <= MOST_COLUMNS else []:
        own = [figures.get("groups", {}).get(drive, {}) for figures in parts]
        table.measure(MAXF, own, f"MaxF\n{drive}")
    table.measure(MAXF, parts, "MaxF\nmean" if drives else "MaxF")
    table.add("95 %", "Bootstrap interval of MaxF over pictures.", _intervals(parts))
    table.add(*_above_floor(parts, names))
    for one in SCORES:
        table.measure(one, parts)
    return table


def part_table(part: Mapping[str, Figures], names: Sequence[str]) -> Table:
    """All figures of one drive, or of a set whose drives are pooled."""
    parts, table = [part[name] for name in names], Table(names)
    table.measure(MAXF, parts)
    table.add(*_above_floor(parts, names))
    for one in (*SCORES, *RANKING, *CHOSEN, *border_measures(parts), *WORKING):
        table.measure(one, parts)
    return table


def further_table(detectors: Mapping[str, Figures], names: Sequence[str]) -> Table:
    """Decisions at the chosen threshold and at MaxF's, borders, and the measures left."""
    parts, table = [detectors[name] for name in names], Table(names)
    for one in (*CHOSEN, *border_measures(parts), *WORKING, *RANKING):
        table.measure(one, parts)
    return table


def _intervals(parts: Sequence[Figures]) -> list[Cell]:
    found = [bounds((figures.get("ci95") or {}).get("maxf")) for figures in parts]
    return [
        Cell(f"{share(one[0])}–{share(one[1])}", one[0]) if one else Cell(NONE) for one in found
    ]


def _above_floor(parts: Sequence[Figures], names: Sequence[str]) -> tuple[str, str, list[Cell]]:
    """MaxF less that of the best floor among the same rows."""
    values = [MAXF.of(figures) for figures in parts]
    floor = best_floor(dict(zip(names, values, strict=True)))
    cells = []
    for value in values:
        above = None if value is None or floor is None else value - floor[1]
        cells.append(Cell(signed(above), above))
    hint = "MaxF less that of the best floor, a detector that never looks at the picture."
    return "above\nfloor", hint, cells


def best_floor(values: Mapping[str, float | None]) -> tuple[str, float] | None:
    """The floor with the highest value."""
    floors = [(name, one) for name, one in values.items() if is_floor(name) and one is not None]
    return max(floors, key=lambda pair: pair[1]) if floors else None


# --- pairs ------------------------------------------------------------------------------

COMPARED = {
    "MaxF": "maxf",
    "AUC": "auc_pooled",
    "AUC\n/image": "auc_mean",
    "AP": "ap",
    "IoU": "iou",
    "Brier": "brier",
    "layout,\nmean recall": "layout_mean",
}


def paired_table(paired: Mapping[str, Any], names: Sequence[str]) -> Table:
    """Differences with intervals, strong where the interval leaves out 0."""
    changes = paired.get("detectors", {})
    table = Table([name for name in names if name in changes])
    hint = "Difference on the same pictures, 95 % interval; bold where that leaves out 0."
    for header, key in COMPARED.items():
        found = [changes[name].get(key) or {} for name in table.names]
        if any(found):
            table.add(header, hint, [_change(one) for one in found])
    return table


def _change(change: Mapping[str, Any]) -> Cell:
    value, ends = number(change.get("difference")), bounds(change.get("ci95"))
    if ends is None:
        return Cell(signed(value), value)
    note = f"{signed(ends[0])} to {signed(ends[1])}"
    return Cell(signed(value), value, ends[0] > 0 or ends[1] < 0, note)


# --- layout -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Layout:
    """The layout figures of one detector: its confusion as rows of shares, and recalls."""

    name: str
    confusion: list[tuple[str, list[Cell]]]
    recalls: Table

    def equals(self, other: "Layout") -> bool:
        """Whether both have the same figures: detectors may share one layout."""
        return replace(self, name=other.name) == other


LAYOUT = (
    *(Measure(name, (name,), f"Share of {name} that is found.") for name in LAYOUT_CLASSES),
    Measure("mean", ("mean",), "Mean of the three."),
    Measure("accuracy", ("accuracy",), "Share of all pixels that are right."),
    Measure("mean, void\nvertical", ("void_as_vertical", "mean"), "Void counted as vertical."),
    Measure("mean,\nlabelled", ("labelled", "mean"), "Where the labeller does not abstain."),
    Measure("labelled", ("labelled_share",), "Share of pixels with a label."),
)


def layouts(detectors: Mapping[str, Figures], series: Sequence[Series]) -> list[Layout]:
    """Confusion and recalls of the detectors in the charts that label the layout."""
    found: list[Layout] = []
    for one in series:
        figures = detectors[one.name]
        if figures.get("layout"):
            layout = Layout(one.name, _confusion(figures["layout"]), _recalls(figures))
            twin = next((i for i, old in enumerate(found) if layout.equals(old)), None)
            if twin is None:
                found.append(layout)
            else:
                found[twin] = replace(found[twin], name=f"{found[twin].name}, {one.name}")
    return found


def _recalls(figures: Figures) -> Table:
    """Recalls by drive and their mean, or of the whole set."""
    groups = figures.get("groups", {})
    parts = {drive: part.get("layout") or {} for drive, part in groups.items()}
    parts["mean" if parts else "all"] = figures["layout"]
    table = Table(list(parts))
    for one in LAYOUT:
        table.measure(replace(one, best=None), list(parts.values()))
    return table


def _confusion(layout: Figures) -> list[tuple[str, list[Cell]]]:
    """Rows truth, columns decision; from lists or from names, empty where there is none."""
    confusion = layout.get("confusion")
    if not confusion:
        return []
    if isinstance(confusion, Mapping):
        confusion = [
            [confusion[row].get(name) for name in LAYOUT_CLASSES] for row in LAYOUT_CLASSES
        ]
    return [
        (name, [Cell(share(number(value)), number(value)) for value in row])
        for name, row in zip(LAYOUT_CLASSES, confusion, strict=True)
    ]
