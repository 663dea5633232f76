"""The tables of README and docs that are written from records (``scripts/bound_figures.py``)."""

from collections.abc import Mapping, Sequence

from scripts.bound_figures import Table
from scripts.readme_evaluations import ROAD

DRIVES = ("0001TP", "0006R0", "0016E5")

FLOORS = ("prior:mean", "prior:rows", "prior:triangle")

CAMERAS = (
    *(
        "cityscapes",
        "comma10k",
        "dn_bdd_drivable",
        "dn_cassed",
        "dn_cat",
        "dn_cityscapes",
        "dn_idd",
    ),
    *("dn_makassar", "dn_mapillary", "dn_mcubes", "dn_nuimages", "dn_tas500", "kitti_semantics"),
    "ycor",
)

CONDITIONS = ("day", "offroad", "rain", "bonnet", "underexposed", "shadow", "dusk", "night")

LAYOUTS = ("layout", "labeller", "layout:cnn-7")

FRONT_PAGE = {
    "`fusion`": "fusion",
    "`fusion:research`, with weights for research and private use": "fusion:research",
    "`fusion:untrained`, which needs no weights": "fusion:untrained",
    "`ufl`, after Zhang et al.": "ufl",
    "`fusion:paper`, Álvarez et al. as printed": "fusion:paper",
    "`prior:rows`: lower is likelier, never looks at the picture": "prior:rows",
}


def _named(detectors: Sequence[str]) -> tuple[tuple[str, str], ...]:
    return tuple((f"`{name}`", name) for name in detectors)


def _with_interval(key: str) -> str:
    return f"[[{key}|.000]] ([[?{key}.low|.000]]–[[?{key}.high|.000]])"


def _cells(run: str, *keys: str) -> tuple[str, ...]:
    return tuple(f"[[{run}.{{row}}.{key}|.000]]" for key in keys)


MEASURES = ("auc_pooled", "auc_mean", "ap", "iou", "eer", "brier")
MEASURE_NAMES = ("AUC pooled", "AUC mean", "AP", "IoU", "EER", "Brier", "F of mask", "ECE")


def _late(run: str) -> tuple[str, ...]:
    """Columns that the first records of these runs had not."""
    return tuple(f"[[?{run}.{{row}}.{key}|.000]]" for key in ("f_mask", "ece"))


_LAYOUT_ROWS = tuple(
    (f"`{name}`, {title}", f"{run}.{name}{at}")
    for name in LAYOUTS
    for run, at, title in (
        *(("camvid", f"@{drive}", drive) for drive in DRIVES),
        ("camvid", "", "CamVid"),
        ("idd", "", "IDD"),
    )
)

TABLES: Mapping[str, Table] = {
    "front": Table(
        ("detector", "fourteen cameras, F", "the worst of them", "CamVid, MaxF", "IDD, MaxF"),
        tuple(FRONT_PAGE.items()),
        (
            "[[many.{row}.f_mask|.000]]",
            "[[many.{row}.f_mask.worst|.000]]",
            "[[camvid.{row}.maxf|.000]]",
            "[[idd.{row}.maxf|.000]]",
        ),
    ),
    "camvid-road": Table(
        (
            "detector",
            *(f"MaxF {one}" for one in DRIVES),
            "mean (95 %)",
            *MEASURE_NAMES,
        ),
        _named((*ROAD, *FLOORS)),
        (
            *_cells("camvid", *(f"maxf@{drive}" for drive in DRIVES)),
            _with_interval("camvid.{row}.maxf"),
            *_cells("camvid", *MEASURES),
            *_late("camvid"),
        ),
        sort="camvid.{row}.maxf",
    ),
    "idd-road": Table(
        ("detector", "MaxF (95 %)", *MEASURE_NAMES),
        _named((*ROAD, *FLOORS)),
        (_with_interval("idd.{row}.maxf"), *_cells("idd", *MEASURES), *_late("idd")),
        sort="idd.{row}.maxf",
    ),
    "pairs": Table(
        ("minus `fusion`", "CamVid, MaxF (95 %)", "IDD, MaxF (95 %)"),
        _named(("fusion:research", "fusion:untrained", "layout", "ufl", "prior:mean")),
        tuple(
            f"[[?{run}.{{row}}.maxf.less|+.000]] ([[?{run}.{{row}}.maxf.less.low|+.000]] to "
            f"[[?{run}.{{row}}.maxf.less.high|+.000]])"
            for run in ("camvid", "idd")
        ),
    ),
    "camvid-roc": Table(
        ("detector", "AUC pooled", "AUC mean over pictures", "over `lbp`", "IDD, AUC pooled"),
        _named(
            ("lbp", "grey-uniformity", "cpf", "cpf:v2", "layout:cnn-7", *("fusion:paper", "fusion"))
        ),
        (
            *_cells("camvid", "auc_pooled", "auc_mean"),
            "[[camvid.{row}.auc_pooled.over_lbp|+0 %]]",
            *_cells("idd", "auc_pooled"),
        ),
    ),
    "layout-recall": Table(
        (
            "detector, pictures",
            "sky",
            "vertical",
            "horizontal",
            "mean",
            "void as vertical",
            "accuracy",
            "mean, labelled",
            "labelled",
        ),
        _LAYOUT_ROWS,
        (
            *(
                f"[[{{row}}.layout.{key}{{at}}|.000]]"
                for key in (
                    "sky",
                    "vertical",
                    "horizontal",
                    "mean",
                    "void_as_vertical.mean",
                    "accuracy",
                )
            ),
            "[[?{row}.layout.labelled.mean{at}|.000]]",
            "[[?{row}.layout.labelled_share{at}|0 %]]",
        ),
    ),
    "layout-confusion": Table(
        ("detector, pictures", "sky → sky / vertical / horizontal", "vertical →", "horizontal →"),
        tuple(
            (f"`{name}`, {title}", f"{run}.{name}")
            for name in LAYOUTS
            for run, title in (("camvid", "CamVid"), ("idd", "IDD"))
        ),
        tuple(
            " / ".join(
                f"[[{{row}}.layout.confusion.{truth}.{said}|.000]]"
                for said in ("sky", "vertical", "horizontal")
            )
            for truth in ("sky", "vertical", "horizontal")
        ),
    ),
    "slow": Table(
        (
            "detector",
            "CamVid, MaxF (95 %)",
            "CamVid, F of mask",
            "IDD, MaxF (95 %)",
            "IDD, F of mask",
        ),
        _named(("fusion", "kmeans-road", "ufl:kitti", "vanishing-point", "prior:rows")),
        tuple(
            text
            for run in ("camvid-slow", "idd-slow")
            for text in (_with_interval(f"{run}.{{row}}.maxf"), *_cells(run, "f_mask"))
        ),
    ),
    "many-detectors": Table(
        ("detector", "F (95 %)", "worst camera, F", "MaxF", "IoU", "ECE"),
        _named(
            (
                "fusion",
                "fusion:research",
                "fusion:untrained",
                "layout",
                "labeller",
                "ufl",
                "fusion:paper",
                "prior:rows",
            )
        ),
        (
            _with_interval("many.{row}.f_mask"),
            *_cells("many", "f_mask.worst", "maxf", "iou_mask", "ece"),
        ),
    ),
    "many-cameras": Table(
        ("camera", "F", "MaxF", "IoU", "`fusion:untrained`, F", "`prior:rows`, MaxF"),
        (*((name, f"@{name}") for name in CAMERAS), ("mean of all", "")),
        (
            "[[many.fusion.f_mask{at}|.000]]",
            "[[many.fusion.maxf{at}|.000]]",
            "[[many.fusion.iou_mask{at}|.000]]",
            "[[many.fusion:untrained.f_mask{at}|.000]]",
            "[[many.prior:rows.maxf{at}|.000]]",
        ),
    ),
    "many-conditions": Table(
        ("condition", "pictures", "F", "MaxF"),
        tuple((name, f"@{name}") for name in CONDITIONS),
        (
            "[[many.fusion.images{at}|0]]",
            "[[many.fusion.f_mask{at}|.000]]",
            "[[many.fusion.maxf{at}|.000]]",
        ),
    ),
}
"""By the name that documents call them."""
